"""Writer and reader of bundles: frames, measurements, arrays and metadata of one episode (docs/design/data.md#bundle).

Works on open binary files, with deterministic bytes and bounded decoding. Opens no path.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from functools import cache, cached_property
from typing import Any, BinaryIO, cast

import numpy as np
from numpy.typing import NDArray

from schemas.encoding.arrays import (
    CORRECTION_ARRAYS,
    DEPTH_FRAME,
    EPISODE_ARRAYS,
    EXPERT_ACTIONS,
    IDS_FRAME,
    POSES,
    RGB_FRAME,
    ArraySpec,
)
from schemas.encoding.container import MAX_CONTAINER_BYTES, ContainerLimits, ContainerReader, ContainerWriter
from schemas.encoding.digest import content_digest, frame_digest
from schemas.encoding.image_sizes import FRAME_SIZE_PX
from schemas.encoding.ndarray import decode_npy, decode_npy_zst, encode_npy, encode_npy_zst, is_npy_of
from schemas.encoding.png import decode_png, encode_png
from schemas.episode import MAX_FRAMES, EpisodeMeta, parse_meta
from schemas.errors import InvalidBundle
from schemas.rig import Rig, Sensor
from schemas.rig.arrays import MAX_MEASURED_IMAGES
from schemas.rig.measurements import SENSORS, Arrays, MeasurementWriter, members_of_rig, read_measurement
from schemas.support.closing import Closing
from schemas.support.stage_timer import StageTimer, no_stage_timer

MAX_BUNDLE_BYTES = MAX_CONTAINER_BYTES
"""Largest size of a bundle, bytes. The frames of an episode take less than 0.5 GB of it."""
_META = "meta.json"
_RGB_SHAPE = (FRAME_SIZE_PX, FRAME_SIZE_PX, 3)
_IMAGE_SHAPE = (FRAME_SIZE_PX, FRAME_SIZE_PX)
_KEPT_FREE_BYTES = 30 << 20
_DEPTH_BYTES = 4 * FRAME_SIZE_PX * FRAME_SIZE_PX + 4096
_LIMITS = ContainerLimits(members=3 * MAX_FRAMES + MAX_MEASURED_IMAGES + 128, member_bytes=64 << 20)
_MAX_META_BYTES = 4 << 20


_STATES_MEMBERS = len(EPISODE_ARRAYS) + 1
"""Number of members of a states recording: arrays and `meta.json`. They are also the last members of other bundles."""


def encode_depth(depth: NDArray[np.float32]) -> bytes:
    """Returns a depth image as a bundle stores it. It has no zstandard checksum, because the container has a CRC of
    each member and the metadata has a digest of each frame."""
    return encode_npy_zst(depth, checksum=False)


def _frame_names(t: int) -> tuple[str, str, str]:
    return f"rgb_front/{t:06d}.png", f"depth_front/{t:06d}.npy.zst", f"seg_front/{t:06d}.png"


def member_names(frames: int, of_rig: Iterable[str] = (), *, is_corrected: bool = False) -> tuple[str, ...]:
    """Returns the member names of a bundle in the order of the file.

    Args:
        frames: number of stored frames.
        of_rig: names of the members that contain the measurements of a rig.
        is_corrected: whether the bundle has the arrays of corrections.
    """
    of_frames = (name for t in range(frames) for name in _frame_names(t))
    return (*of_frames, *of_rig, *(f"{spec.name}.npy" for spec in _specs(is_corrected)), _META)


def _specs(is_corrected: bool) -> tuple[ArraySpec, ...]:
    return (*EPISODE_ARRAYS, *CORRECTION_ARRAYS) if is_corrected else EPISODE_ARRAYS


@dataclass(frozen=True)
class Corrections:
    """What the planner wanted in an episode that a policy drove, and who acted."""

    expert_actions: NDArray[np.float32]
    """(T, 2) twist that the planner wants at the pose of a step: v in m/s, w in rad/s; NaN without a label."""
    drivers: NDArray[np.uint8]
    """(T,) who acted, as `schemas.terms.Driver` numbers them."""
    route_m: NDArray[np.float32]
    """(T,) distance from the planner's path of the start, metres. Where it is large, words of the instruction that
    depend on the place of the robot, such as "on your left", may be wrong."""


@dataclass(frozen=True)
class EpisodeArrays:
    """Arrays of an episode of T steps, as `schemas.encoding.arrays` specifies them."""

    actions_continuous: NDArray[np.float32]
    """(T, 2) commanded twist: v in m/s, w in rad/s."""
    actions_tokens: NDArray[np.int16]
    """(T, 2) action tokens, 0..6."""
    poses: NDArray[np.float64]
    """(T, 7) poses of base_link in the world frame: x, y, z in metres, qw, qx, qy, qz."""

    corrections: Corrections | None = None
    """Corrections of the planner; `None` for a demonstration."""

    def in_order(self) -> tuple[NDArray[np.generic], ...]:
        """Returns the arrays in the order of `EPISODE_ARRAYS`, then those of `CORRECTION_ARRAYS`, if any."""
        arrays = tuple(getattr(self, spec.name) for spec in EPISODE_ARRAYS)
        if self.corrections is None:
            return arrays
        return (*arrays, *(getattr(self.corrections, spec.name) for spec in CORRECTION_ARRAYS))


def seal(meta: EpisodeMeta, frame_digests: Sequence[str], arrays: EpisodeArrays) -> EpisodeMeta:
    """Returns the metadata of an episode with its digests."""
    digest = content_digest(frame_digests, arrays.in_order(), meta.canonical())
    return meta.model_copy(update={"frame_digests": tuple(frame_digests), "content_digest": digest})


class BundleWriter:
    """Streaming writer of a bundle; memory does not grow with the length of the episode."""

    def __init__(self, file: BinaryIO, timer: StageTimer = no_stage_timer) -> None:
        """Starts a bundle.

        Args:
            file: seekable file, opened for writing.
            timer: called at the end of the stages `png rgb`, `depth`, `png ids` and `bundle` of every frame.
        """
        self._out = ContainerWriter(file)
        self._timer = timer
        self._digests: list[str] = []
        self._measurements = MeasurementWriter(self._out.add)

    def add_frame(self, rgb: NDArray[np.uint8], depth: NDArray[np.float32], ids: NDArray[np.uint16]) -> None:
        """Appends one frame: (640, 640, 3) sRGB, (640, 640) metres, (640, 640) instance ids."""
        names = _frame_names(len(self._digests))
        colour = encode_png(rgb)
        self._timer("png rgb")
        metres = encode_depth(depth)
        self._timer("depth")
        instances = encode_png(ids)
        self._timer("png ids")
        for name, data in zip(names, (colour, metres, instances), strict=True):
            self._out.add(name, data)
        self.add_digest(rgb, depth, ids)
        self._timer("bundle")

    def add_digest(self, rgb: NDArray[np.uint8], depth: NDArray[np.float32], ids: NDArray[np.uint16]) -> None:
        """Adds the digest of a frame without storing the frame, for a states recording."""
        self._digests.append(frame_digest(rgb, depth, ids))

    def add_measurement(self, sensor: Sensor, t: int | None, arrays: Arrays) -> None:
        """Appends a measurement of a sensor, after all frames; raises the errors of `MeasurementWriter.add`."""
        self._measurements.add(sensor, t, arrays)
        self._timer("sensors")

    @property
    def frame_digests(self) -> tuple[str, ...]:
        """Digests of the frames added so far."""
        return tuple(self._digests)

    def finish(self, arrays: EpisodeArrays, meta: EpisodeMeta) -> EpisodeMeta:
        """Appends arrays and metadata and closes the bundle.

        Args:
            arrays: arrays of the episode; their length is the number of frames.
            meta: metadata of the episode; this method fills in the digests.

        Returns:
            The metadata as written, with digests.
        """
        meta = meta.model_copy(update={"sensor_digests": self._measurements.digests})
        sealed = seal(meta, self._digests, arrays)
        for spec, array in zip(_specs(arrays.corrections is not None), arrays.in_order(), strict=True):
            self._out.add(f"{spec.name}.npy", encode_npy(array))
        self._out.add(_META, sealed.model_dump_json(indent=1).encode())
        self._out.close()
        return sealed


class BundleReader(Closing):
    """Random access to an episode in a seekable file; frames are decoded on request.

    Args:
        file: seekable file, opened for reading.
        steps: number of steps of the episode, if known from another source. The metadata is then read and validated
            at the first access only, which halves the time to open a bundle.

    Raises:
        InvalidBundle: the file is not a bundle, is incomplete, has surplus members, or has a newer format.
    """

    def __init__(self, file: BinaryIO, steps: int | None = None) -> None:
        _keep_freed_memory()
        self._in = ContainerReader(file, _LIMITS)
        self.name: str | None = None
        """Id of the episode in its dataset, if known from there; a merged dataset has renumbered it."""
        self.length = self.meta.rollout.num_steps if steps is None else steps
        if self.length > MAX_FRAMES:  # checked first, because `member_names` takes time and memory for each step
            raise InvalidBundle("bundle refused", [f"{self.length} steps; a bundle has at most {MAX_FRAMES}"])
        is_corrected = f"{EXPERT_ACTIONS.name}.npy" in self._in.names
        tail = _STATES_MEMBERS + (len(CORRECTION_ARRAYS) if is_corrected else 0)
        self.has_frames = len(self._in.names) > tail
        """Whether the bundle stores frames; a states recording does not."""
        self.has_sensors = self.has_frames and self._in.names[-tail - 1].startswith(SENSORS)
        """Whether the bundle stores the measurements of a rig."""
        of_rig = members_of_rig(self._rig(), self.length, self.control_hz) if self.has_sensors else ()
        expected = member_names(self.length if self.has_frames else 0, of_rig, is_corrected=is_corrected)
        if self._in.names != expected:
            raise InvalidBundle("bundle refused", _name_findings(self._in.names, expected))
        arrays: dict[str, NDArray[Any]] = {spec.name: self._array(spec) for spec in _specs(is_corrected)}
        corrections = Corrections(*(arrays.pop(spec.name) for spec in CORRECTION_ARRAYS)) if is_corrected else None
        self.pose_dtype = arrays[POSES.name].dtype
        """Type of the stored poses; float32 in bundles of format 1."""
        arrays[POSES.name] = arrays[POSES.name].astype(POSES.dtype)
        self.arrays = EpisodeArrays(**arrays, corrections=corrections)

    @property
    def episode_id(self) -> str:
        """Id of the episode in its dataset, or else in its run."""
        return self.name or self.meta.episode_id

    @cached_property
    def meta(self) -> EpisodeMeta:
        """Metadata of the episode.

        Raises:
            InvalidBundle: the metadata is damaged or has a newer format.
        """
        if _META in self._in.names and self._in.size(_META) > _MAX_META_BYTES:
            raise InvalidBundle(
                "bundle refused", [f"{_META} has {self._in.size(_META)} bytes: limit {_MAX_META_BYTES}"]
            )
        return parse_meta(self._in.read(_META))

    def _array(self, spec: ArraySpec) -> NDArray[np.generic]:
        shape = tuple(self.length if side is None else side for side in spec.shape)
        data = self._in.read(f"{spec.name}.npy")
        former = spec.former_dtype
        dtype = former if former is not None and is_npy_of(data, former, shape) else spec.dtype
        array = decode_npy(spec.name, data, dtype, shape)
        findings = spec.value_violations(array)  # `decode_npy` has checked shape and dtype
        if findings:
            raise InvalidBundle("bundle refused", findings)
        return array

    def rgb(self, t: int) -> NDArray[np.uint8]:
        """Returns frame t as (640, 640, 3) sRGB."""
        name = _frame_names(t)[0]
        return cast(NDArray[np.uint8], decode_png(name, self._in.read(name), _RGB_SHAPE))

    def depth(self, t: int) -> NDArray[np.float32]:
        """Returns frame t as (640, 640) metres along the optical axis, 0 where nothing was hit."""
        name = _frame_names(t)[1]
        depth = decode_npy_zst(name, self._in.read(name), dtype=np.float32, shape=_IMAGE_SHAPE, max_bytes=_DEPTH_BYTES)
        return cast(NDArray[np.float32], depth)

    def ids(self, t: int) -> NDArray[np.uint16]:
        """Returns frame t as (640, 640) instance ids."""
        name = _frame_names(t)[2]
        return cast(NDArray[np.uint16], decode_png(name, self._in.read(name), _IMAGE_SHAPE))

    def _rig(self) -> Rig:
        rig = self.meta.job.view.rig
        if rig is None:
            raise InvalidBundle("bundle refused", ["it has measurements of sensors, but its job has no rig"])
        return rig

    @property
    def control_hz(self) -> int:
        """Control rate, steps per second."""
        return self.meta.job.task.control_hz

    def measurement(self, sensor: Sensor, t: int | None) -> dict[str, NDArray[Any]]:
        """Returns the stored arrays of a sensor by name.

        Args:
            sensor: sensor of the rig of the episode.
            t: step at which the sensor measures; `None` for all measurements of a sensor of motion.

        Raises:
            InvalidBundle: an array is missing, damaged or out of bounds.
        """
        return read_measurement(self._in.read, sensor, t=t, length=self.length, control_hz=self.control_hz)

    def stored(self, name: str) -> bytes:
        """Returns the encoded bytes of a member, e.g. `rgb_front/000000.png`, after a check of its CRC."""
        return self._in.read(name)

    def frame_digest(self, t: int) -> str:
        """Decodes frame t, checks it against its specs and returns its digest.

        Raises:
            InvalidBundle: a modality of the frame is damaged or out of bounds.
        """
        rgb, depth, ids = self.rgb(t), self.depth(t), self.ids(t)
        texts = RGB_FRAME.violations(rgb) + DEPTH_FRAME.violations(depth) + IDS_FRAME.violations(ids)
        findings = [f"frame {t}: {text}" for text in texts]
        if findings:
            raise InvalidBundle("bundle refused", findings)
        return frame_digest(rgb, depth, ids)

    def content_digest(self, frame_digests: tuple[str, ...]) -> str:
        """Returns the content digest over the given frame digests, the arrays and the metadata."""
        return content_digest(frame_digests, self._stored_arrays(), self.meta.canonical())

    def states_digest(self) -> str:
        """Returns the XXH3-128 over arrays and metadata; equal for the frames and states recording of an episode."""
        return content_digest((), self._stored_arrays(), self.meta.canonical_states())

    def _stored_arrays(self) -> tuple[NDArray[np.generic], ...]:
        return replace(self.arrays, poses=self.arrays.poses.astype(self.pose_dtype)).in_order()

    def member_bytes(self) -> dict[str, int]:
        """Returns the stored size of each kind of member, e.g. `rgb_front`, bytes."""
        sizes: dict[str, int] = {}
        for name in self._in.names:
            kind = name.split("/")[0]
            sizes[kind] = sizes.get(kind, 0) + self._in.size(name)
        return sizes

    def close(self) -> None:
        """Leaves the file open; the caller owns it."""


@cache
def _keep_freed_memory() -> None:
    """Raises glibc's thresholds for returning freed memory to the kernel (mallopt(3), M_MMAP_THRESHOLD).

    After a block of `_KEPT_FREE_BYTES` was freed, glibc keeps up to twice as much freed memory. Otherwise glibc may
    return the pages of every frame to the kernel, and the next frame causes 900 to 1300 page faults, which take a
    quarter of the decoding time of a frame. The pages of the block itself are never accessed.
    """
    np.empty(_KEPT_FREE_BYTES, np.uint8)  # not mallopt, which ends glibc's automatic adjustment of the thresholds


def _name_findings(names: tuple[str, ...], expected: tuple[str, ...]) -> list[str]:
    missing = [name for name in expected if name not in set(names)]
    surplus = [name for name in names if name not in set(expected)]
    findings = [f"{len(missing)} members missing, first {missing[0]!r}"] if missing else []
    findings += [f"{len(surplus)} unexpected members, first {surplus[0]!r}"] if surplus else []
    return findings or ["members are not in their fixed order"]
