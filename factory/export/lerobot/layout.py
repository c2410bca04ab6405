"""Layout of a LeRobot dataset: its image features and numeric columns, for the recorded camera or for a rig.

LeRobot policies use every column whose name begins with `observation` or `action`, and every image or video whatever
its name (`dataset_to_policy_features`). Tokens, world poses and the outcome therefore have other names, and depth and
ids are in a second dataset, `extra/`, with the same episodes and rows.

Pure functions.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

from factory.export.lerobot.columns import (
    ACTION_NAMES,
    DONE,
    INTERVENTION,
    POSE_NAMES,
    REWARD,
    SUCCESS,
    TOKEN_NAMES,
)
from factory.export.options import LeRobotOptions
from factory.export.rig.description import FRONT, recorded_rig
from schemas.config import CameraConfig
from schemas.encoding.image_sizes import FRAME_SIZE_PX
from schemas.errors import UsageError
from schemas.rig import (
    Camera,
    CameraOutput,
    DepthKind,
    EquirectangularCamera,
    Imu,
    Lidar2d,
    Lidar3d,
    Rig,
    WheelOdometry,
)
from schemas.support.geometry import STATE_NAMES
from workers.geometry.faces import plan_faces

IMU_NAMES = ("gyro_x_rps", "gyro_y_rps", "gyro_z_rps", "force_x_mps2", "force_y_mps2", "force_z_mps2")
RGB, DEPTH, IDS = f"observation.images.{FRONT}", f"depth.{FRONT}", f"ids.{FRONT}"
STATE = "observation.state"
CAMERA_POSE, CAMERA_MATRIX = "camera_pose", "camera_matrix"
"""Names of the columns of a camera, before its name."""
MATRIX_NAMES = ("fx", "skew", "cx", "zero_10", "fy", "cy", "zero_20", "zero_21", "one")
"""Names of the values of a camera matrix, row by row."""
EXTRA_FOLDER = "extra"
"""Folder of the second dataset, with depth and ids."""


class ImageFeature(NamedTuple):
    """Image feature: colour and depth are videos, instance ids are PNG images."""

    key: str
    output: CameraOutput
    width: int
    height: int
    file: str
    """File name of the video in a piece; empty for instance ids, which are not a video."""
    largest_m: float
    """Depth of the largest depth code, metres."""
    camera: Camera | None = None
    """Camera of the rig; `None` for the recorded camera."""

    @property
    def is_video(self) -> bool:
        return self.output is not CameraOutput.IDS

    @property
    def channels(self) -> int:
        return 3 if self.output is CameraOutput.RGB else 1


class Column(NamedTuple):
    """Numeric column of the data files."""

    dtype: str
    names: tuple[str, ...] | None = None
    """Names of the values; `None` for scalars and scans."""
    shape: tuple[int, ...] = ()
    """Shape of a value: empty for a scalar, (rays,) or (lines, rays) for a scan."""
    sensor: Imu | WheelOdometry | Lidar2d | Lidar3d | None = None
    """Sensor of the rig that measures the values."""
    camera: str | None = None
    """Camera whose pose in the world, or whose matrix, the values are."""

    @property
    def is_scan(self) -> bool:
        """Whether a value is a scan. The statistics of a scan are computed over all of its ranges together."""
        return isinstance(self.sensor, Lidar2d | Lidar3d)


@dataclass(frozen=True)
class Layout:
    """Features of a dataset."""

    images: tuple[ImageFeature, ...]
    columns: Mapping[str, Column]
    """Name -> column, in the order of the data files, after the images."""
    rows_file: str = "frames.parquet"
    """File of the rows in a piece."""

    @property
    def videos(self) -> tuple[ImageFeature, ...]:
        return tuple(image for image in self.images if image.is_video)

    @property
    def pictures(self) -> tuple[ImageFeature, ...]:
        """Image features that are images in the data files."""
        return tuple(image for image in self.images if not image.is_video)


def layout_of(recorded: CameraConfig, rig: Rig | None, *, is_corrected: bool = False) -> Layout:
    """Returns the layout of the dataset, with the colour images of the recorded camera or the sensors of a rig.

    Args:
        recorded: recorded camera.
        rig: rig of the export; `None` for the recorded camera.
        is_corrected: whether the episodes have corrections; a column then says in which frames the planner acted.

    Raises:
        UsageError: two sensors of the rig have the same feature, or width or height of a video is odd.
    """
    images = _images_of(recorded, rig, (CameraOutput.RGB,))
    columns = [*_COLUMNS.items()] if rig is None else [*_columns_of(rig)]
    if is_corrected:
        columns.insert([name for name, _ in columns].index(DONE) + 1, (INTERVENTION, Column("bool")))
    place = [name for name, _ in columns].index("pose") + 1
    return _checked(Layout(images, dict(columns)), [*columns[:place], *_cameras_of(recorded, rig), *columns[place:]])


def extra_layout_of(options: LeRobotOptions, recorded: CameraConfig, rig: Rig | None) -> Layout | None:
    """Returns the layout of the second dataset, with depth and ids; `None` if neither is exported.

    Raises:
        UsageError: width or height of a video is odd.
    """
    wanted = [output for output in (CameraOutput.DEPTH, CameraOutput.IDS) if getattr(options, output)]
    images = _images_of(recorded, rig, wanted)
    if not images:
        return None
    shown = {image.key.partition(".")[2] for image in images}
    poses = [(name, column) for name, column in _cameras_of(recorded, rig) if name.partition(".")[2] in shown]
    return _checked(Layout(images, {}, "extra.parquet"), [*poses, *_INDICES.items()])


def _checked(layout: Layout, columns: Sequence[tuple[str, Column]]) -> Layout:
    _require_different([*(image.key for image in layout.images), *(name for name, _ in columns)])
    _require_even(layout)
    return replace(layout, columns=dict(columns))


def _vector(names: tuple[str, ...], dtype: str = "float32", sensor: Imu | WheelOdometry | None = None) -> Column:
    return Column(dtype, names, (len(names),), sensor)


_INDICES: Mapping[str, Column] = {
    "timestamp": Column("float32"),
    **dict.fromkeys(("frame_index", "episode_index", "index", "task_index"), Column("int64")),
}
"""Columns that LeRobot requires."""
_COLUMNS: Mapping[str, Column] = {
    STATE: _vector(STATE_NAMES),
    "action": _vector(ACTION_NAMES),
    "tokens": _vector(TOKEN_NAMES, "int64"),
    "pose": _vector(POSE_NAMES),
    REWARD: Column("float32"),
    SUCCESS: Column("bool"),
    DONE: Column("bool"),
    **_INDICES,
}
"""Numeric columns of an export without a rig."""


def _images_of(recorded: CameraConfig, rig: Rig | None, wanted: Sequence[CameraOutput]) -> tuple[ImageFeature, ...]:
    """Returns the features of the wanted outputs of the recorded camera, or of the cameras of a rig that have them."""
    size, far = FRAME_SIZE_PX, recorded.far_m
    if rig is None:
        return tuple(
            ImageFeature(_key(FRONT, one), one, width=size, height=size, file=_video(FRONT, one), largest_m=far)
            for one in wanted
        )
    return tuple(
        ImageFeature(
            _key(camera.name, output),
            output,
            width=camera.width,
            height=camera.height,
            file=_video(camera.name, output),
            largest_m=largest_depth(camera) if output is CameraOutput.DEPTH else camera.far_m,
            camera=camera,
        )
        for camera in rig.cameras
        for output in wanted
        if output in camera.outputs
    )


def _key(camera: str, output: CameraOutput) -> str:
    return f"observation.images.{camera}" if output is CameraOutput.RGB else f"{output}.{camera}"


def _video(camera: str, output: CameraOutput) -> str:
    return "" if output is CameraOutput.IDS else f"{output}.{camera}.mp4"


def _cameras_of(recorded: CameraConfig, rig: Rig | None) -> Iterator[tuple[str, Column]]:
    """Yields the columns of each camera: the pose of its optical frame in the world, and its matrix."""
    for camera in (rig or recorded_rig(recorded)).cameras:
        yield f"{CAMERA_POSE}.{camera.name}", _vector(POSE_NAMES)._replace(camera=camera.name)
        if not isinstance(camera, EquirectangularCamera):
            yield f"{CAMERA_MATRIX}.{camera.name}", _vector(MATRIX_NAMES)._replace(camera=camera.name)


def largest_depth(camera: Camera) -> float:
    """Returns the largest possible value of the depth images of a camera, metres."""
    if camera.depth is DepthKind.AXIAL:
        return camera.far_m
    return camera.far_m * max(face.view.corner for face in plan_faces(camera).faces)


def _columns_of(rig: Rig) -> Iterator[tuple[str, Column]]:
    """Yields the columns of a rig: the state from its first odometry, other sensors, then the rest of `_COLUMNS`."""
    wheels = [sensor for sensor in rig.sensors if isinstance(sensor, WheelOdometry)]
    yield STATE, _vector(STATE_NAMES, sensor=wheels[0] if wheels else None)
    for sensor in rig.sensors:
        name = f"observation.{sensor.name}"
        match sensor:
            case Imu():
                yield name, _vector(IMU_NAMES, sensor=sensor)
            case WheelOdometry() if sensor is not wheels[0]:
                yield name, _vector(STATE_NAMES, sensor=sensor)
            case Lidar2d():
                yield name, Column("float32", None, (sensor.samples,), sensor)
            case Lidar3d():
                yield name, Column("float32", None, (len(sensor.elevations_deg), sensor.samples), sensor)
    yield from (item for item in _COLUMNS.items() if item[0] != STATE)


def _require_different(keys: list[str]) -> None:
    twice = [key for key, count in Counter(keys).items() if count > 1]
    if twice:
        raise UsageError(f"two sensors have the same feature {twice[0]!r}: rename a sensor of the rig")


def _require_even(layout: Layout) -> None:
    for image in layout.videos:
        if image.width % 2 or image.height % 2:
            raise UsageError(
                f"feature {image.key!r} has {image.width} x {image.height} pixels; an H.264 video needs even numbers: "
                "change width or height of the camera by one pixel"
            )
