"""Keyframes, camera poses, pixel goals and depth images of the exports for InternNav and NavDP."""

from __future__ import annotations

import io
import math

import numpy as np
import pytest
from PIL import Image

from factory.export.internnav import (
    FORWARD,
    LEFT,
    RIGHT,
    PixelGoal,
    camera_poses,
    encode_depth,
    intrinsic_of,
    keyframes,
    pixel_goal,
    setting_of,
)
from factory.export.rig.description import recorded_rig
from schemas.config import CameraConfig
from schemas.rig import PinholeCamera

OPTICAL = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])
CAMERA = CameraConfig(x_m=0.1, y_m=-0.2, z_m=0.5)


def recorded(camera: CameraConfig) -> PinholeCamera:
    (pinhole,) = recorded_rig(camera).cameras
    assert isinstance(pinhole, PinholeCamera)
    return pinhole


def poses(*states: tuple[float, float, float]) -> np.ndarray:
    """Returns poses of x, y and yaw in degrees."""
    half = [math.radians(yaw) / 2 for _, _, yaw in states]
    return np.array(
        [(x, y, 0.0, math.cos(h), 0.0, 0.0, math.sin(h)) for (x, y, _), h in zip(states, half, strict=True)]
    )


def test_keyframes_end_at_a_quarter_metre_and_at_fifteen_degrees() -> None:
    driven = poses((0, 0, 0), (0.2, 0, 0), (0.26, 0, 0), (0.26, 0, 10), (0.26, 0, 16), (0.26, 0, -1), (0.27, 0, -1))
    assert keyframes(driven) == ([0, 2, 4, 5, 6], [-1, FORWARD, LEFT, RIGHT, FORWARD])


def test_turns_across_the_end_of_the_circle_have_their_direction() -> None:
    assert keyframes(poses((0, 0, 170), (0, 0, -174)))[1] == [-1, LEFT]


def test_the_camera_is_at_its_place_on_the_robot_and_looks_along_its_axis() -> None:
    (pose,) = camera_poses(poses((1.0, 2.0, 90.0)), recorded(CAMERA), OPTICAL)
    assert pose[:3, 3] == pytest.approx((1.2, 2.1, 0.5))  # x of base_link is y of the world
    assert pose[:3, 2] == pytest.approx((0.0, 1.0, 0.0), abs=1e-9)
    assert pose[:3, 1] == pytest.approx((0.0, 0.0, -1.0))


def test_the_goal_is_the_farthest_visible_position_on_the_floor() -> None:
    centred = recorded(CameraConfig(x_m=0.0, y_m=0.0, z_m=0.5))
    (pose,) = camera_poses(poses((0, 0, 0)), centred, OPTICAL)
    track = np.array([(x, 0.0, 0.0) for x in (0.0, 1.0, 2.0)])
    focal, _, centre = intrinsic_of(centred)[0].tolist()
    clear = np.full((640, 640), 5.0, np.float32)
    assert pixel_goal(pose, clear, centred, track) == PixelGoal(round(focal * 0.5 / 2.0 + centre), round(centre), 2)
    near = np.full((640, 640), 1.5, np.float32)
    assert pixel_goal(pose, near, centred, track) == PixelGoal(round(focal * 0.5 / 1.0 + centre), round(centre), 1)
    assert pixel_goal(pose, np.full((640, 640), 0.5, np.float32), centred, track) == PixelGoal(-1, -1, -1)
    assert pixel_goal(pose, clear, centred, -track) == PixelGoal(-1, -1, -1), "behind the robot"
    assert pixel_goal(pose, clear, centred, track * 0.2) == PixelGoal(-1, -1, -1), "too near"


def test_depth_has_the_unit_of_the_loader_and_ends_at_the_largest_value() -> None:
    stored = np.asarray(Image.open(io.BytesIO(encode_depth(np.array([[0.0, 1.25, 9.0]], np.float32), 10_000))))
    assert stored.tolist() == [[0, 12_500, 65_535]]


def test_the_name_of_a_setting_states_height_and_pitch() -> None:
    assert setting_of(CameraConfig(z_m=0.3444)) == "34cm_0deg"
