"""The geometry of the camera: position, orientation and projection."""

from __future__ import annotations

import math

import numpy as np
import pytest

from schemas.config import CameraConfig
from workers.geometry.camera import intrinsics, optical_pose, projection_matrix, view_matrix
from workers.geometry.pose import Pose

CAMERA = CameraConfig()
SIZE = 640


def project(pose: Pose, point: tuple[float, float, float]) -> np.ndarray:
    """Returns (column, row, depth), computed with the optical frame and the intrinsics."""
    optical = optical_pose(pose, CAMERA)
    local = optical.rotation.T @ (np.array(point) - optical.eye)
    column, row, depth = intrinsics(CAMERA, SIZE) @ local
    return np.array((column / depth, row / depth, depth))


def project_by_gl(pose: Pose, point: tuple[float, float, float]) -> np.ndarray:
    """Returns (column, row, depth), computed with the matrices of OpenGL."""
    clip = projection_matrix(CAMERA) @ view_matrix(optical_pose(pose, CAMERA)) @ np.array((*point, 1.0))
    x, y = clip[:2] / clip[3]
    return np.array(((x + 1) / 2 * SIZE, (1 - y) / 2 * SIZE, clip[3]))


def test_the_camera_has_the_configured_position() -> None:
    eye = optical_pose(Pose.planar(2.0, 3.0, math.pi / 2, z=0.1), CAMERA).eye
    assert eye == pytest.approx((2.0 + 0.075, 3.0 + 0.1003, 0.1 + 0.3444))


def test_optical_axes_are_right_down_and_forward() -> None:
    right, down, forward = optical_pose(Pose.planar(0.0, 0.0, 0.0), CAMERA).rotation.T
    assert right == pytest.approx((0, -1, 0))
    assert down == pytest.approx((0, 0, -1))
    assert forward == pytest.approx((1, 0, 0))


def test_optical_axes_are_a_right_handed_frame_at_any_tilt() -> None:
    half = 0.3
    tilted = Pose(1.0, 2.0, 3.0, math.cos(half), math.sin(half) * 0.6, 0.0, math.sin(half) * 0.8)
    rotation = optical_pose(tilted, CAMERA).rotation
    assert rotation @ rotation.T == pytest.approx(np.eye(3))
    assert np.linalg.det(rotation) == pytest.approx(1.0)


def test_a_point_ahead_is_projected_to_the_centre() -> None:
    assert project(Pose.planar(0.0, 0.0, 0.0), (5.0, -0.075, 0.3444)) == pytest.approx((320, 320, 4.8997))


def test_a_point_to_the_left_and_above_is_projected_left_and_above() -> None:
    column, row, _ = project(Pose.planar(0.0, 0.0, 0.0), (5.0, 1.0, 1.0))
    assert column < 320
    assert row < 320


def test_a_field_of_view_of_90_degrees_at_640_pixels_has_a_focal_length_of_320() -> None:
    assert intrinsics(CAMERA, SIZE) == pytest.approx(np.array([[320, 0, 320], [0, 320, 320], [0, 0, 1]]))


def test_opengl_and_the_pinhole_agree_on_every_pixel() -> None:
    pose = Pose.planar(-1.0, 0.5, 2.2, z=0.3)
    ahead = np.array((math.cos(2.2), math.sin(2.2), 0.0)) * 4
    for offset in np.random.default_rng(0).uniform(-1, 1, (20, 3)):
        point = tuple((np.array((pose.x, pose.y, 0.6)) + ahead + offset).tolist())
        assert project_by_gl(pose, point) == pytest.approx(project(pose, point))


def test_clip_planes_bound_the_depth() -> None:
    projection = projection_matrix(CAMERA)
    for depth, edge in ((CAMERA.near_m, -1.0), (CAMERA.far_m, 1.0)):
        clip = projection @ np.array((0.0, 0.0, -depth, 1.0))
        assert clip[2] / clip[3] == pytest.approx(edge)


@pytest.mark.parametrize("yaw", [-3.0, -1.0, 0.0, 0.5, 3.1])
def test_planar_poses_keep_their_yaw(yaw: float) -> None:
    assert Pose.planar(1.0, 2.0, yaw).yaw == pytest.approx(yaw)
