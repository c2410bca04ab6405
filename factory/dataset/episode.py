"""Reads one archived episode: opens the bundle on first access and decodes or renders it frame by frame.

Writes nothing.
"""

from __future__ import annotations

import os
import weakref
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from functools import cached_property
from threading import Lock
from typing import TYPE_CHECKING, BinaryIO, Self

import numpy as np
from numpy.typing import NDArray

from factory.dataset.bundle import EpisodeBundle
from factory.dataset.packages import ScenePackage
from factory.dataset.steps import read_questions, read_steps
from schemas.appearance import Appearance, DrawnAppearance
from schemas.bundle import BundleReader, Corrections
from schemas.dataset.rows import EpisodeSummary
from schemas.encoding.image_sizes import FRAME_SIZE_PX
from schemas.episode import EpisodeMeta
from schemas.errors import ArchiveCorrupt, InvalidBundle, UsageError
from schemas.frame import Frame
from schemas.language.question.meaning import Question
from schemas.language.route.meaning import SubInstruction
from schemas.rig import Imu, Rig, Sensor, WheelOdometry
from schemas.scene import Instance
from schemas.storage.place import FilePlace
from schemas.storage.shard_index import episode_place
from schemas.support.closing import Closing

if TYPE_CHECKING:
    from workers.sensors import CameraMeasurement, ImuMeasurements, LidarScan, OdometryMeasurements


class Episode(Closing):
    """Archived episode of T steps: T frames, T actions, T poses; frame t and pose t precede action t.

    The frames of a states recording are rendered when they are read (docs/dataset.md#recordings).

    Construction and pickling read no file; each process opens the file at its first access. Instances are thread-safe.

    Raises:
        ArchiveCorrupt: The file is missing or damaged. Raised at access; the message contains the path.
    """

    def __init__(
        self, path: FilePlace, summary: EpisodeSummary, rig: Rig | None = None, ranges: Appearance | None = None
    ) -> None:
        self.path = path
        self.summary = summary
        """Row of the episode in the metadata table."""
        self.rig = rig
        """Rig of `observe`."""
        self.ranges = ranges
        """Ranges of `appearance`, for frames that are rendered."""
        self._opened: _Opened | None = None
        self._opening = Lock()

    @property
    def episode_id(self) -> str:
        """Episode id, such as `ep_000001`."""
        return self.summary.episode_id

    @property
    def instruction(self) -> str:
        """Language instruction of the episode."""
        return self.summary.instruction

    @property
    def meta(self) -> EpisodeMeta:
        """Recorded metadata of the episode, without its arrays."""
        with self._reading() as bundle:
            return bundle.meta

    @property
    def appearance(self) -> DrawnAppearance | None:
        """Factors of the appearance of the frames (docs/appearance.md); `None` if they show the scene as compiled."""
        with self._reading() as bundle:
            return bundle.appearance

    @property
    def instances(self) -> tuple[Instance, ...]:
        """Instances that the ids of the frames refer to."""
        with self._reading() as bundle:
            return bundle.instances

    @property
    def package(self) -> ScenePackage:
        """Compiled scene of the episode."""
        with self._reading() as bundle:
            return bundle.package

    @cached_property
    def steps(self) -> tuple[SubInstruction, ...]:
        """Sub-instructions of the first route, whose spans cover all frames; empty if the episode has no route.

        `factory relabel` writes routes (docs/language.md#routes).
        """
        return read_steps(self.path.parents[1], self.episode_id)

    @cached_property
    def questions(self) -> tuple[Question, ...]:
        """Questions about the episode with answers and reasons (docs/language.md#questions)."""
        written = read_questions(self.path.parents[1], self.episode_id)
        return self.meta.questions if written is None else written

    @property
    def actions(self) -> NDArray[np.float32]:
        """(T, 2) commanded twists: v in m/s, w in rad/s."""
        return self._bundle().arrays.actions_continuous

    @property
    def tokens(self) -> NDArray[np.int16]:
        """(T, 2) action tokens on the 7 x 7 grid, 0..6."""
        return self._bundle().arrays.actions_tokens

    @property
    def corrections(self) -> Corrections | None:
        """Actions of the planner and who acted, in an episode that a policy drove; `None` for a demonstration."""
        return self._bundle().arrays.corrections

    @property
    def poses(self) -> NDArray[np.float64]:
        """(T, 7) poses of base_link in the world frame: x, y, z in metres and the quaternion w, x, y, z."""
        return self._bundle().arrays.poses

    @property
    def states_digest(self) -> str:
        """XXH3-128 over the arrays and the metadata; equal in both recordings of an episode."""
        with self._reading() as bundle:
            return bundle.states_digest()

    def rgb(self, t: int) -> NDArray[np.uint8]:
        """Returns the colour image at step t, (640, 640, 3) sRGB; a negative t counts from the end."""
        with self._reading() as bundle:
            return bundle.rgb(self._step(t))

    def depth(self, t: int) -> NDArray[np.float32]:
        """Returns the depth image at step t, (640, 640) metres along the optical axis; negative t: from the end."""
        with self._reading() as bundle:
            return bundle.depth(self._step(t))

    def ids(self, t: int) -> NDArray[np.uint16]:
        """Returns the instance ids at step t, (640, 640); a negative t counts from the end."""
        with self._reading() as bundle:
            return bundle.ids(self._step(t))

    def stored(self, name: str) -> bytes:
        """Returns the encoded bytes of a member, such as `seg_front/000000.png`, as a recording of frames has it."""
        with self._reading() as bundle:
            return bundle.stored(name)

    def frame(self, t: int, size: int = FRAME_SIZE_PX, antialias: int = 1) -> Frame:
        """Returns all images at step t; a negative t counts from the end.

        Args:
            t: step.
            size: width and height, pixels; frames of a different size than the recorded 640 are rendered.
            antialias: samples per pixel along each axis; with more than 1, frames are rendered. The colour of a pixel
                is the mean of its samples, depth and id are those of the middle sample.
        """
        with self._reading() as bundle:
            if bundle.has_frames and (size, antialias) == (FRAME_SIZE_PX, 1):
                return Frame(self.rgb(t), self.depth(t), self.ids(t))
            return bundle.render(self._step(t), size, antialias)

    def frames(self, stride: int = 1, size: int = FRAME_SIZE_PX, antialias: int = 1) -> Iterator[Frame]:
        """Yields every `stride`-th frame in order; keeps one frame in memory."""
        return (self.frame(t, size, antialias) for t in range(0, len(self), stride))

    def observe(self, t: int, sensors: Iterable[str] | None = None) -> dict[str, CameraMeasurement | LidarScan]:
        """Returns the images of the rig's cameras and the scans of its lidars at step t, by name (docs/rigs.md).

        They are rendered when they are read, unless the episode stores these sensors. A sensor with a lower rate than
        the control rate is omitted at the steps between two measurements.

        Args:
            t: step; a negative t counts from the end.
            sensors: names of cameras and lidars; all by default.

        Raises:
            UsageError: The dataset was opened without a rig, or the rig has no sensor of that name.
        """
        from factory.dataset.sensor_reading import observe

        # not stored by default, because the images of a rig take 100 MB and more per episode, and the states 15 kB
        chosen, step = self._sensors(sensors), self._step(t)
        with self._reading() as bundle:
            hz = bundle.meta.job.task.control_hz
            return {
                name: observe(bundle, sensor, step)
                for name, sensor in chosen.items()
                if not isinstance(sensor, Imu | WheelOdometry) and step % sensor.stride(hz) == 0
            }

    def motion(self, sensors: Iterable[str] | None = None) -> dict[str, ImuMeasurements | OdometryMeasurements]:
        """Returns the measurements of the rig's IMUs and wheel odometry over the whole episode, by name.

        Args:
            sensors: names of IMUs and wheel odometry; all by default.

        Raises:
            UsageError: The dataset was opened without a rig, or the rig has no sensor of that name.
        """
        from factory.dataset.sensor_reading import measure

        chosen = self._sensors(sensors)
        with self._reading() as bundle:
            motion_sensors = {
                name: sensor for name, sensor in chosen.items() if isinstance(sensor, Imu | WheelOdometry)
            }
            return {name: measure(bundle, sensor) for name, sensor in motion_sensors.items()}

    def _sensors(self, names: Iterable[str] | None) -> Mapping[str, Sensor]:
        if self.rig is None:
            raise UsageError(f"{self.episode_id} has no rig: open the dataset as Dataset(path, rig='paper')")
        return self.rig.choose(names)

    def __len__(self) -> int:
        return self.summary.num_steps

    def __repr__(self) -> str:
        return f"Episode({self.episode_id}, {len(self)} steps, {self.instruction!r})"

    def _step(self, t: int) -> int:
        if not -len(self) <= t < len(self):
            raise IndexError(f"{self.episode_id} has steps 0 to {len(self) - 1}, not {t}")
        return t % len(self)

    def _bundle(self) -> EpisodeBundle:
        with self._opening:
            if self._opened is None or self._opened.pid != os.getpid():  # a forked process shares the file position
                self._opened = self._open()
            return self._opened.bundle

    def _open(self) -> _Opened:
        # the table gives the number of steps: checking the metadata of the file would take half of the opening time
        try:
            return _Opened(self.path, len(self), self.ranges)
        except FileNotFoundError:  # the coordinator of a run may have packed the episode meanwhile
            self.path = episode_place(self.path.parents[1], self.summary.index)
        try:
            return _Opened(self.path, len(self), self.ranges)
        except FileNotFoundError as error:
            raise ArchiveCorrupt(f"{self.path} is missing: run `factory verify`") from error

    @contextmanager
    def _reading(self) -> Iterator[EpisodeBundle]:
        try:
            yield self._bundle()
        except InvalidBundle as error:
            raise _corrupt(self.path, error) from error

    def close(self) -> None:
        """Closes the file; a later access opens it again."""
        if self._opened is not None:
            self._opened.close()
            self._opened = None

    def __reduce__(self) -> tuple[type[Self], tuple[FilePlace, EpisodeSummary, Rig | None, Appearance | None]]:
        return type(self), (self.path, self.summary, self.rig, self.ranges)


class _Opened:
    """Open bundle with its file and the id of the process that opened it; garbage collection closes the file.

    Raises:
        FileNotFoundError: the file does not exist.
        ArchiveCorrupt: the file cannot be read or is damaged.
    """

    def __init__(self, path: FilePlace, steps: int, ranges: Appearance | None) -> None:
        try:
            file: BinaryIO = path.open("rb")
        except FileNotFoundError:
            raise
        except OSError as error:
            raise ArchiveCorrupt(f"{path} cannot be read: {error.strerror}") from error
        self.close = weakref.finalize(self, file.close)
        self.pid = os.getpid()
        try:
            self.bundle = EpisodeBundle(file, path.parents[1], steps, ranges)
            self.bundle.name = path.stem
        except InvalidBundle as error:
            refusal = _refusal(path, file, steps)
            self.close()
            raise refusal from error


def _refusal(path: FilePlace, file: BinaryIO, steps: int) -> ArchiveCorrupt:
    """Returns the error for a bundle that is damaged or does not have the expected number of steps."""
    try:
        bundle = BundleReader(file)
    except InvalidBundle as error:
        return _corrupt(path, error)
    return ArchiveCorrupt(f"{path} has {bundle.length} steps, the metadata has {steps}: run `factory verify --deep`")


def _corrupt(path: FilePlace, error: InvalidBundle) -> ArchiveCorrupt:
    return ArchiveCorrupt(f"{path} is damaged ({'; '.join(error.findings)}): run `factory verify --deep`")
