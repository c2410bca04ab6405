"""Options of the export formats; each field becomes an option of `factory export`. Imports no exporter, no dataset."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType
from typing import TYPE_CHECKING, Literal

from pydantic import Field, SerializerFunctionWrapHandler, model_serializer

from schemas.base import Model
from schemas.encoding.image_sizes import FRAME_SIZE_PX
from schemas.errors import UsageError
from schemas.support.extras import require_package

if TYPE_CHECKING:
    from schemas.dataset.meta import DatasetMeta

START_TIME_S = 1_767_225_600
"""Default start time of ROS 2 stamps, 2026-01-01 00:00 UTC, seconds since 1970."""
SPACING_S = 60
"""Interval between the start times of consecutive episodes, seconds. It is longer than an episode: 1000 frames at 60 Hz
take 17 s."""
_LATEST_S = 2**31 - 1
"""Maximum of the 32-bit seconds of a ROS time."""


class Options(Model):
    """Options of a format. Each field becomes a command line option with its description as help text.

    Fields are `bool`, `int`, `int | None` or a `Literal` of strings, and all have defaults. Formats that share a field
    name must define the field identically.
    """

    def check(self, meta: DatasetMeta) -> None:
        """Validates the options against a dataset, before anything is written.

        Raises:
            UsageError: the options conflict with each other or with the dataset, e.g. a rate that does not divide the
                recorded rate.
        """


class Decimated(Options):
    """Options of a format with a selectable frame rate."""

    fps: int | None = Field(
        default=None,
        ge=1,
        le=240,
        description="Frame rate, 1/s, a divisor of the dataset's rate. Default: the dataset's rate.",
    )

    def check(self, meta: DatasetMeta) -> None:
        """Validates that the rate divides the recorded rate."""
        stride_of(self.fps, meta.plan.task.control_hz)


def stride_of(fps: int | None, recorded_hz: int) -> int:
    """Returns the stride n: every n-th recorded frame is exported.

    Raises:
        UsageError: the requested rate does not divide the recorded rate.
    """
    wanted = recorded_hz if fps is None else fps
    if wanted < 1 or recorded_hz % wanted:
        rates = ", ".join(str(rate) for rate in range(1, recorded_hz + 1) if recorded_hz % rate == 0)
        raise UsageError(f"--fps {wanted}: the dataset has {recorded_hz} frames per second; valid values: {rates}")
    return recorded_hz // wanted


class PaperOptions(Options):
    """Options of format `paper`."""

    split_names: Literal["paper", "published"] = Field(
        default="paper",
        description="Names of the splits, as in the paper or as in its published repository. Default: paper.",
    )


class LeRobotOptions(Decimated):
    """Options of both LeRobot versions."""

    depth: bool = Field(default=False, description="Also write metric depth, as lossless 12-bit video. Default: no.")
    ids: bool = Field(default=False, description="Also write instance ids, as 16-bit PNG images. Default: no.")


class LeRobotV21Options(Decimated):
    """Options of version 2.1, which does not support depth video and 16-bit images."""


class WebdatasetOptions(Decimated):
    """Options of format `webdataset`."""

    shard_mb: int = Field(
        default=500, ge=1, le=8000, description="Size of a shard, MB; its last episode may exceed it. Default: 500."
    )


class McapOptions(Decimated):
    """Options of format `mcap`. The rate applies to images; all other topics keep the recorded rate."""

    ros2: bool = Field(default=False, description="Write ROS 2 messages (extra `ros2`). Default: Foxglove messages.")
    start_time: int | None = Field(
        default=None,
        ge=1,
        le=_LATEST_S,
        description=f"Unix time of frame 0 of the first episode, seconds; with --ros2 only. Default: {START_TIME_S}.",
    )

    @model_serializer(mode="wrap")
    def _leave_out_unused(self, serialize: SerializerFunctionWrapHandler) -> dict[str, object]:
        """Omits unused options, so manifests without them equal those of versions that did not have these options."""
        data: dict[str, object] = serialize(self)
        return {key: value for key, value in data.items() if value or key not in ("ros2", "start_time")}

    def check(self, meta: DatasetMeta) -> None:
        """Validates the rate, the start time (ROS 2 only, 32 bits) and the package for ROS 2."""
        super().check(meta)
        if self.start_time is not None and not self.ros2:
            raise UsageError("--start-time requires --ros2: the times of Foxglove messages start at 0")
        latest = _LATEST_S - SPACING_S * meta.planned
        if self.ros2 and self.start_s > latest:
            raise UsageError(
                f"--start-time {self.start_s}: {meta.planned} episodes, {SPACING_S} s apart, exceed the 32 bits of a "
                f"ROS time in 2038; give at most {latest}"
            )
        if self.ros2:
            require_package("rosbags", "format mcap with --ros2")

    @property
    def start_s(self) -> int:
        """Time of frame 0 of the first episode, seconds since 1970."""
        return START_TIME_S if self.start_time is None else self.start_time


class Resized(Decimated):
    """Options of a format with images of a selectable size."""

    image_px: int = Field(
        default=256,
        ge=16,
        le=FRAME_SIZE_PX,
        description=f"Side of the images, pixels; {FRAME_SIZE_PX} is the recorded size. Default: 256.",
    )


class RldsOptions(WebdatasetOptions, Resized):
    """Options of format `rlds`."""

    loader_splits: bool = Field(
        default=False,
        description="Name train_id and val_id as the loaders of OpenVLA and Octo do, train and val. Default: no.",
    )


class RobomimicOptions(Resized):
    """Options of format `robomimic`."""


_QUALITY = "JPEG quality, 1 to 100. Default: 92."


class GnmOptions(Decimated):
    """Options of format `gnm`."""

    jpeg_quality: int = Field(default=92, ge=1, le=100, description=_QUALITY)


class CocoOptions(Decimated):
    """Options of format `coco`."""


class NavDpOptions(GnmOptions):
    """Options of format `navdp`."""


class InternNavOptions(Options):
    """Options of format `internnav`, whose frames are chosen by the motion of the robot."""

    jpeg_quality: int = Field(default=92, ge=1, le=100, description=_QUALITY)


OPTIONS: Mapping[str, type[Options]] = MappingProxyType(
    {
        "paper": PaperOptions,
        "lerobot": LeRobotOptions,
        "lerobot-v2.1": LeRobotV21Options,
        "webdataset": WebdatasetOptions,
        "mcap": McapOptions,
        "gnm": GnmOptions,
        "vlnce": Options,
        "coco": CocoOptions,
        "navdp": NavDpOptions,
        "internnav": InternNavOptions,
        "rlds": RldsOptions,
        "robomimic": RobomimicOptions,
    }
)
"""Options of each format by its name, in the order of the registry."""
