"""Measures how far rendered frames differ from recorded ones, per channel. Renders and reads nothing."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from factory.dataset.episode import Frame

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
        """Adds the values of another difference."""
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
