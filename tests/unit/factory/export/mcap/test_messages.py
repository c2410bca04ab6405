"""The messages of an MCAP export before encoding."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from factory.export.mcap.messages import calibration, measured_twists, stamp_of
from factory.export.rig.description import OPTICAL_QUATERNION, recorded_rig
from schemas.config import CameraConfig
from workers.geometry.camera import intrinsics, optical_pose
from workers.geometry.pose import Pose


def arc(v: float, w: float, steps: int, hz: int, yaw: float = 0.0) -> np.ndarray:
    """Returns poses of a robot with constant speeds; exact for straight drives and turns on the spot."""
    times = np.arange(steps) / hz
    heading = yaw + w * times
    poses = np.zeros((steps, 7))
    poses[:, 0], poses[:, 1] = v * times * math.cos(yaw), v * times * math.sin(yaw)
    poses[:, 3], poses[:, 6] = np.cos(heading / 2), np.sin(heading / 2)
    return poses


@pytest.mark.parametrize("yaw", [0.0, 2.0, -3.1])
def test_a_straight_drive_is_measured_along_the_x_axis_of_the_robot(yaw):
    twists = measured_twists(arc(0.5, 0.0, 30, 60, yaw), 60)
    np.testing.assert_allclose(twists[1:], [[0.5, 0.0]] * 29, atol=2e-4)
    assert tuple(twists[0]) == (0.0, 0.0)


def test_measured_twists_do_not_jump_where_the_yaw_wraps():
    twists = measured_twists(arc(0.0, 1.5, 60, 60, yaw=3.0), 60)
    np.testing.assert_allclose(twists[1:], [[0.0, 1.5]] * 59, atol=2e-4)


def test_times_are_whole_nanoseconds_that_never_drift():
    assert [stamp_of(t, 60) for t in (0, 1, 3, 60, 999)] == [0, 16_666_666, 50_000_000, 10**9, 16_650_000_000]


def test_the_optical_frame_is_that_of_the_renderer():
    camera = CameraConfig()
    optical = optical_pose(Pose(0, 0, 0, 1, 0, 0, 0), camera)
    np.testing.assert_allclose(
        Rotation.from_quat(OPTICAL_QUATERNION, scalar_first=True).as_matrix(), optical.rotation, atol=1e-12
    )


def test_the_calibration_is_that_of_the_renderer_with_pixel_centres_on_whole_numbers():
    camera = CameraConfig(fov_deg=70.0)
    expected = intrinsics(camera, 640) - np.array([[0, 0, 0.5], [0, 0, 0.5], [0, 0, 0]])
    said = calibration(recorded_rig(camera).cameras[0])
    np.testing.assert_allclose(np.reshape(said["K"], (3, 3)), expected)
    np.testing.assert_allclose(np.reshape(said["P"], (3, 4))[:, :3], expected)
