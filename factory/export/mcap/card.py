"""Text of the card of an MCAP export: topics and message types of a profile. Pure functions."""

from __future__ import annotations

from factory.export.rig.document import RIG_FILE, rig_table
from schemas.rig import Rig

_FOXGLOVE_CARD = """
One MCAP file per episode, `episodes/ep_000001.mcap`: chunked, compressed with zstd, indexed; times begin at frame 0.

| topic | schema |
|---|---|
{camera}\
| `/tf` | foxglove.FrameTransforms: world -> base_link{optical} |
| `/odom` | foxglove.Odometry: pose in the world, twist measured from the poses |
| `/action` | minivla.Action: commanded v_mps, w_rps and their tokens |
| `/instruction`, `/target`, `/map` | foxglove.Log, SceneUpdate, Grid; at frame 0 |
| `/path/driven`, `/path/planned` | foxglove.PosesInFrame; at frame 0 |
"""
_FOXGLOVE_CAMERA = """\
| `/camera/rgb` | foxglove.CompressedImage, PNG 640 x 640 |
| `/camera/depth` | foxglove.RawImage, 32FC1, metres along the optical axis, 0 where nothing was hit |
| `/camera/ids` | foxglove.RawImage, 16UC1, instance ids; the attachment `meta.json` names them |
| `/camera/calibration` | foxglove.CameraCalibration |
"""
_ROS2_CARD = """
One MCAP file per episode, `episodes/ep_000001.mcap`: profile `ros2` (CDR), chunked, compressed with zstd, indexed; for
`ros2 bag`, `rosbags` and Foxglove. Episode n starts {spacing} (n - 1) s after {start} s since 1970.

| topic | message |
|---|---|
{camera}\
| `/tf`, `/tf_static` | map -> odom -> base_link{optical} |
| `/odom` | nav_msgs/Odometry: pose in odom, which is exact here, twist measured from the poses |
| `/cmd_vel` | geometry_msgs/Twist: the command |
| `/action_tokens` | std_msgs/UInt8MultiArray: the command on the 7 x 7 grid |
| `/instruction`, `/target`, `/map` | std_msgs/String, visualization_msgs/MarkerArray, nav_msgs/OccupancyGrid; once |
| `/path/driven`, `/path/planned` | nav_msgs/Path; once |
"""


_ROS2_CAMERA = """\
| `/camera/rgb/image_raw/compressed` | sensor_msgs/CompressedImage, PNG 640 x 640 |
| `/camera/depth/image_raw` | sensor_msgs/Image, 32FC1, metres along the optical axis, +Inf where nothing was hit |
| `/camera/ids/image_raw` | sensor_msgs/Image, mono16, instance ids; the attachment `meta.json` names them |
| `/camera/rgb/camera_info`, `/camera/depth/camera_info` | sensor_msgs/CameraInfo |
"""
_FOXGLOVE_SENSORS = """\
| `/<camera>/rgb`, `depth`, `ids`, `normals`, `flow` | CompressedImage, PNG; RawImage: 32FC1, 16UC1, 32FC3, 32FC2 |
| `/<camera>/calibration` | foxglove.CameraCalibration: plumb_bob, or kannala_brandt of a fisheye; not of a panorama |
| `/<lidar>/scan`, `/<lidar>/points` | foxglove.LaserScan, +Inf without a return; PointCloud: x, y, z, ring, id |
| `/<imu>/imu` | minivla.Imu: angular velocity, specific force |
| `/<odometry>/odom` | foxglove.Odometry in the frame `<odometry>_start`, with encoder ticks |
"""
_ROS2_SENSORS = """\
| `/<camera>/rgb/image_raw/compressed` | sensor_msgs/CompressedImage, PNG |
| `/<camera>/depth/image_raw`, `ids`, `normals`, `flow` | sensor_msgs/Image: 32FC1, mono16, 32FC3, 32FC2 |
| `/<camera>/rgb/camera_info`, ... | sensor_msgs/CameraInfo: plumb_bob, or equidistant of a fisheye; not of a panorama |
| `/<lidar>/scan`, `/<lidar>/points` | sensor_msgs/LaserScan, +Inf without a return; PointCloud2: x, y, z, ring, id |
| `/<imu>/imu` | sensor_msgs/Imu without orientation |
| `/<odometry>/odom`, `/<odometry>/ticks` | nav_msgs/Odometry in frame `<odometry>_start`; std_msgs/Int64MultiArray |
"""
_FRAMES = """
Each sensor has the frame `<sensor>_link` (x forward, z up), and each camera `<camera>_optical_frame` (z forward).
"""


def foxglove_card(rig: Rig | None, control_hz: int) -> str:
    """Returns the text for messages of Foxglove."""
    if rig is None:
        return _FOXGLOVE_CARD.format(camera=_FOXGLOVE_CAMERA, optical=" -> front_optical")
    return _FOXGLOVE_CARD.format(camera=_FOXGLOVE_SENSORS, optical=" -> sensors") + _sensors(rig, control_hz)


def ros2_card(spacing_s: int, start_s: int, rig: Rig | None, control_hz: int) -> str:
    """Returns the text for messages of ROS 2.

    Args:
        spacing_s: interval between the starts of consecutive episodes, seconds.
        start_s: start of the first episode, seconds since 1970.
        rig: exported sensors; `None` for the recorded camera.
        control_hz: control rate, steps per second.
    """
    times = {"spacing": spacing_s, "start": start_s}
    if rig is None:
        optical = " -> front_camera_link -> front_camera_optical_frame"
        return _ROS2_CARD.format(camera=_ROS2_CAMERA, optical=optical, **times)
    return _ROS2_CARD.format(camera=_ROS2_SENSORS, optical=" -> sensors", **times) + _sensors(rig, control_hz)


def _sensors(rig: Rig, control_hz: int) -> str:
    return _FRAMES + rig_table(rig, control_hz, f"attachment {RIG_FILE}")
