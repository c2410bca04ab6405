"""Renders frames of an episode and measures its sensors again, and compares both with the recording.

Changes no files.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from coordinator.validation.rollout import arrival_findings, visibility_findings
from coordinator.validation.start import start_findings
from factory.dataset.bundle import EpisodeBundle
from factory.dataset.episode import Episode
from factory.dataset.rendering import shared_renderer
from factory.dataset.sensor_reading import trajectory_of
from schemas.encoding.digest import frame_digest
from schemas.frame import Frame
from schemas.rig import Imu, WheelOdometry
from schemas.scene import Target
from schemas.terms import Recording
from workers.sensors.observation import arrays_in, measure, observe

CHANNELS = ("red", "green", "blue", "depth", "ids")
_IDS = "ids"


@dataclass
class ChannelDifference:
    """Differences between recorded and rendered values of one channel: levels of 0..255, metres, or ids."""

    values: int = 0
    """Number of compared values."""
    unequal: int = 0
    """Number of values that differ."""
    total: float = 0.0
    """Sum of the absolute differences."""
    largest: float = 0.0
    """Largest absolute difference."""

    @property
    def share(self) -> float:
        """Share of the values that differ, 0..1."""
        return self.unequal / self.values if self.values else 0.0

    @property
    def mean(self) -> float:
        """Mean absolute difference of all values."""
        return self.total / self.values if self.values else 0.0

    def add(self, recorded: NDArray[Any], rendered: NDArray[Any]) -> None:
        """Adds two images of equal shape."""
        apart = np.abs(recorded.astype(np.float64) - rendered.astype(np.float64))
        self.merge(
            ChannelDifference(apart.size, int(np.count_nonzero(apart)), float(apart.sum()), float(apart.max(initial=0)))
        )

    def merge(self, other: ChannelDifference) -> None:
        self.values += other.values
        self.unequal += other.unequal
        self.total += other.total
        self.largest = max(self.largest, other.largest)


@dataclass
class RenderDifference:
    """Comparison of rendered frames with the recorded digests and, where they are available, the recorded pixels."""

    frames: int = 0
    """Number of frames that were compared with a digest."""
    differing: int = 0
    """Number of frames whose digest differs from the recorded one."""
    measured: int = 0
    """Number of frames whose recorded pixels were available."""
    recorded_with: set[str] = field(default_factory=set)
    """Renderers of the recordings."""
    rendered_with: set[str] = field(default_factory=set)
    """Renderers of this verification."""
    channels: dict[str, ChannelDifference] = field(
        default_factory=lambda: {name: ChannelDifference() for name in CHANNELS}
    )
    """Differences over all measured frames, by channel."""

    def add_equal(self, pixels: int, is_measured: bool) -> None:
        """Adds a frame whose digest equals the recorded one; if `is_measured`, its pixels count as equal."""
        self.frames += 1
        if is_measured:
            self.measured += 1
            for channel in self.channels.values():
                channel.values += pixels

    def add_differing(self, recorded: Frame | None, rendered: Frame) -> None:
        """Adds a frame whose digest differs; `recorded` is `None` if the recorded pixels are not available."""
        self.frames += 1
        self.differing += 1
        if recorded is not None:
            self.measured += 1
            for name, one, other in zip(CHANNELS, _channels(recorded), _channels(rendered), strict=True):
                self.channels[name].add(one, other)

    def merge(self, other: RenderDifference) -> None:
        """Adds the frames of another comparison."""
        self.frames += other.frames
        self.differing += other.differing
        self.measured += other.measured
        self.recorded_with |= other.recorded_with
        self.rendered_with |= other.rendered_with
        for name, channel in self.channels.items():
            channel.merge(other.channels[name])

    def plain(self) -> dict[str, Any]:
        """Returns the comparison as JSON values; ids have a share only, because their distance has no meaning."""
        channels = {
            name: {"share": channel.share}
            | ({} if name == _IDS else {"largest": channel.largest, "mean": channel.mean})
            for name, channel in self.channels.items()
        }
        return {
            "frames": self.frames,
            "differing": self.differing,
            "measured": self.measured,
            "recorded_with": sorted(self.recorded_with),
            "rendered_with": sorted(self.rendered_with),
            "channels": channels if self.measured else None,
        }


def _channels(frame: Frame) -> tuple[NDArray[Any], ...]:
    return (*np.moveaxis(frame.rgb, -1, 0), frame.depth, frame.ids)


def compare_rendered(
    bundle: EpisodeBundle,
    difference: RenderDifference,
    reference: Episode | None = None,
    candidates: Sequence[Target] = (),
) -> list[str]:
    """Renders every frame with a recorded digest, measures samples of stored sensors, and returns the findings.

    Args:
        bundle: open episode.
        difference: comparison to which the frames are added. It measures how far pixels differ if the episode or the
            reference stores them.
        reference: the same episode in a frames recording.
        candidates: possible targets of the episode; empty if the scene cannot be read.

    Raises:
        WorldError: this machine cannot render.
        ArchiveCorrupt: the scene package is missing or was changed, or the reference cannot be read.
    """
    shared_renderer().omit_warnings()
    job, digests = bundle.meta.job, bundle.meta.frame_digests
    steps = range(bundle.length) if job.record is Recording.FRAMES else job.sampled_steps(bundle.length)
    lines: list[str] = []
    differing: list[int] = []
    target_pixels: dict[int, int] = {}
    for t, recorded in zip(steps, digests, strict=False):  # the validator reports a wrong number of digests
        frame = bundle.render(t)
        if t == 0 and not bundle.has_frames:  # the validator has checked the start view of stored frames
            lines += start_findings(bundle.meta, bundle.arrays, ids=frame.ids, depth=frame.depth, candidates=candidates)
        target_pixels[t] = int(np.count_nonzero(frame.ids == bundle.meta.target_instance_id))
        if frame_digest(frame.rgb, frame.depth, frame.ids) == recorded:
            difference.add_equal(frame.depth.size, bundle.has_frames or reference is not None)
            continue
        differing.append(t)
        stored = _stored_frame(bundle, reference, t)
        if stored is not None and reference is not None and frame_digest(*stored) != recorded:
            lines.append(f"frame {t} of the reference {reference.path} is not the recorded one")
            stored = None
        difference.add_differing(stored, frame)
    lines += visibility_findings(bundle.meta, target_pixels)
    if not bundle.has_frames and bundle.length - 1 in target_pixels:
        lines += arrival_findings(bundle.meta, target_pixels[bundle.length - 1])
    difference.recorded_with.add(bundle.meta.provenance.fingerprint.renderer)
    difference.rendered_with.add(shared_renderer().description)
    lines += _sensor_findings(bundle)
    return [*lines, _digest_finding(bundle, differing)] if differing else lines


def _sensor_findings(bundle: EpisodeBundle) -> list[str]:
    """Measures the stored sensors again, and returns the differences as findings.

    Motion sensors are compared over the whole episode. Of each other sensor, only the last sample at or before each
    sampled step is compared.
    """
    rig = bundle.meta.job.view.rig if bundle.has_sensors else None
    sampled = bundle.meta.job.sampled_steps(bundle.length)
    findings = []
    for sensor in rig.sensors if rig else ():
        if isinstance(sensor, Imu | WheelOdometry):
            again = arrays_in(measure(sensor, trajectory_of(bundle)))
            if not _are_equal(bundle.measurement(sensor, None), again):
                findings.append(f"sensor {sensor.name} differs when it is measured again")
            continue
        stride = sensor.stride(bundle.control_hz)
        for t in sorted({step // stride * stride for step in sampled}):
            again = arrays_in(observe(sensor, t, trajectory_of(bundle), bundle))
            if not _are_equal(bundle.measurement(sensor, t), again):
                findings.append(f"sensor {sensor.name} differs at step {t} when it is measured again")
    return findings


def _are_equal(stored: Mapping[str, NDArray[Any]], again: Mapping[str, NDArray[Any]]) -> bool:
    return stored.keys() == again.keys() and all(stored[name].tobytes() == again[name].tobytes() for name in stored)


def _stored_frame(bundle: EpisodeBundle, reference: Episode | None, t: int) -> Frame | None:
    """Returns the recorded frame, or `None` if neither the episode nor a reference stores it."""
    if bundle.has_frames:
        return Frame(bundle.rgb(t), bundle.depth(t), bundle.ids(t))
    return None if reference is None else reference.frame(t)


def _digest_finding(bundle: EpisodeBundle, differing: list[int]) -> str:
    return (
        f"{len(differing)} of {len(bundle.meta.frame_digests)} frames differ when they are rendered again, first frame "
        f"{differing[0]}; recorded with {bundle.meta.provenance.fingerprint.renderer}, rendered with "
        f"{shared_renderer().description}"
    )
