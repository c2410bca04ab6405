"""Projection of the camera models, with OpenCV as the reference, and the flow of known motions."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from schemas.rig import Camera, EquirectangularCamera, FisheyeCamera, Mount, PinholeCamera
from schemas.support.numpy_types import Floats
from workers.geometry.camera import mounted_pose
from workers.geometry.lens import optical_flow, pixel_centres, project, unproject
from workers.geometry.pose import Pose

PINHOLE = PinholeCamera(
    name="pinhole", model="pinhole", width=640, height=480, fx_px=400, fy_px=410, cx_px=315, cy_px=250,
    distortion=(-0.28, 0.09, 0.0012, -0.0008, -0.01),
)  # fmt: skip
FISHEYE = FisheyeCamera(
    name="fisheye", model="fisheye", width=800, height=600, fov_deg=196, fx_px=210, fy_px=212, cx_px=405, cy_px=296,
    distortion=(-0.012, 0.004, -0.0021, 0.0003),
)  # fmt: skip
PANORAMA = EquirectangularCamera(name="panorama", model="equirectangular", width=512, height=256)
CAMERAS = [pytest.param(camera, id=camera.model) for camera in (PINHOLE, FISHEYE, PANORAMA)]


def matrix_of(camera: PinholeCamera | FisheyeCamera) -> Floats:
    """Returns OpenCV's camera matrix, in which the centre of the first pixel is (0, 0)."""
    (fx, fy), (cx, cy) = camera.focal_px, camera.centre_px
    return np.array(((fx, 0, cx - 0.5), (0, fy, cy - 0.5), (0, 0, 1)))


def points_ahead(count: int = 2000, reach: float = 0.7) -> Floats:
    rng = np.random.default_rng(7)
    plane = rng.uniform(-reach, reach, (count, 2))
    return np.column_stack((plane, np.ones(count))) * rng.uniform(0.2, 20, (count, 1))


def test_a_pinhole_camera_projects_as_opencv_does():
    points = points_ahead()
    expected, _ = cv2.projectPoints(points, np.zeros(3), np.zeros(3), matrix_of(PINHOLE), np.array(PINHOLE.distortion))
    assert np.abs(project(PINHOLE, points) - 0.5 - expected[:, 0]).max() < 1e-6


def test_a_fisheye_camera_projects_as_opencv_does():
    points = points_ahead(reach=3.0)
    expected, _ = cv2.fisheye.projectPoints(
        points[:, None], np.zeros(3), np.zeros(3), matrix_of(FISHEYE), np.array(FISHEYE.distortion)
    )
    assert np.abs(project(FISHEYE, points) - 0.5 - expected[:, 0]).max() < 1e-6


def test_undistorted_pixels_are_those_of_opencv():
    pixels = np.random.default_rng(3).uniform((0, 0), (640, 480), (500, 2))
    criteria = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 200, 1e-12)
    expected = (
        cv2.undistortPointsIter(
            (pixels - 0.5)[:, None], matrix_of(PINHOLE), np.array(PINHOLE.distortion), None, None, criteria
        )[:, 0]
        if hasattr(cv2, "undistortPointsIter")
        else cv2.undistortPoints(
            (pixels - 0.5)[:, None], matrix_of(PINHOLE), np.array(PINHOLE.distortion), None, None, None, criteria
        )[:, 0]
    )
    rays = unproject(PINHOLE, pixels)
    assert np.abs(rays[:, :2] / rays[:, 2:] - expected).max() * 400 < 0.01


@pytest.mark.parametrize("camera", CAMERAS)
def test_projecting_the_ray_of_a_pixel_gives_the_pixel(camera: Camera):
    pixels = pixel_centres(camera)
    rays = unproject(camera, pixels)
    seen = ~np.isnan(rays[..., 0])
    assert np.abs(np.linalg.norm(rays[seen], axis=-1) - 1).max() < 1e-12
    assert np.abs(project(camera, rays * 3.0) - pixels)[seen].max() < 1e-6


def test_the_image_circle_has_the_field_of_view():
    camera = FisheyeCamera(name="eye", model="fisheye", width=400, height=400, fov_deg=180)
    rays = unproject(camera, np.array(((200.0, 0.001), (399.999, 200.0), (200.0, 200.0), (1.0, 1.0))))
    assert rays[0] == pytest.approx((0, -1, 0), abs=1e-4)
    assert rays[1] == pytest.approx((1, 0, 0), abs=1e-4)
    assert rays[2] == pytest.approx((0, 0, 1), abs=1e-9)
    assert np.isnan(rays[3]).all()


@pytest.mark.parametrize(
    ("point", "pixel"),
    [
        ((0, 0, 1), (256, 128)),  # ahead
        ((1, 0, 0), (384, 128)),  # right
        ((-1, 0, 0), (128, 128)),  # left
        ((0, -1, 1), (256, 64)),  # up
        ((1e-9, 0, -1), (512, 128)),  # behind
    ],
)
def test_the_middle_of_a_panorama_is_ahead_and_its_right_part_is_to_the_right(point, pixel):
    assert project(PANORAMA, np.array(point, float)) == pytest.approx(pixel, abs=1e-4)


def test_a_camera_sees_nothing_behind_itself_or_outside_of_its_circle():
    behind = np.array((0.1, 0.2, -1.0))
    assert np.isnan(project(PINHOLE, behind)).all()
    assert np.isnan(project(FISHEYE, behind)).all()


@pytest.mark.parametrize("camera", CAMERAS)
def test_a_camera_that_stands_still_has_no_flow(camera: Camera):
    eye = mounted_pose(Pose.planar(1.0, 2.0, 0.3), Mount(z_m=1.0))
    flow = optical_flow(camera, np.full((camera.height, camera.width), 2.0), eye, eye)
    seen = ~np.isnan(unproject(camera, pixel_centres(camera))[..., 0])
    assert np.nanmax(np.abs(flow)) < 1e-6
    assert (~np.isnan(flow[..., 0]) == seen).all()


def test_turning_left_moves_a_panorama_to_the_right_by_the_angle():
    eyes = [mounted_pose(Pose.planar(0.0, 0.0, yaw), Mount(z_m=1.0)) for yaw in (0.0, 0.1)]
    flow = optical_flow(PANORAMA, np.full((256, 512), 2.0), *eyes)
    assert flow[..., 0] == pytest.approx(np.full((256, 512), 0.1 / (2 * np.pi) * 512), abs=1e-6)
    assert np.abs(flow[..., 1]).max() < 1e-6


def test_driving_towards_a_wall_spreads_its_pixels():
    camera = PinholeCamera(name="front", model="pinhole", width=100, height=80, fov_deg=90)
    eyes = [mounted_pose(Pose.planar(x, 0.0, 0.0), Mount(z_m=1.0)) for x in (0.0, 0.5)]
    rays = unproject(camera, pixel_centres(camera))
    flow = optical_flow(camera, 2.0 / rays[..., 2], *eyes)  # a wall at 2 m, then at 1.5 m
    assert flow == pytest.approx((pixel_centres(camera) - (50, 40)) * (2.0 / 1.5 - 1), abs=1e-9)


def test_pixels_without_a_surface_have_no_flow():
    camera = PinholeCamera(name="front", model="pinhole", width=16, height=8, fov_deg=90)
    eye = mounted_pose(Pose.planar(0.0, 0.0, 0.0), Mount(z_m=1.0))
    assert np.isnan(optical_flow(camera, np.zeros((8, 16)), eye, eye)).all()


def test_a_mount_turns_about_the_fixed_axes_in_the_order_of_a_urdf():
    left = mounted_pose(Pose.planar(0, 0, 0), Mount(z_m=1.0, yaw_deg=90)).rotation
    assert left[:, 2] == pytest.approx((0, 1, 0), abs=1e-12)  # looks to the left
    down = mounted_pose(Pose.planar(0, 0, 0), Mount(z_m=1.0, pitch_deg=90)).rotation
    assert down[:, 2] == pytest.approx((0, 0, -1), abs=1e-12)
    both = mounted_pose(Pose.planar(0, 0, 0), Mount(z_m=1.0, roll_deg=90, yaw_deg=90)).rotation
    assert both[:, 2] == pytest.approx((0, 1, 0), abs=1e-12)
    assert both[:, 1] == pytest.approx((-1, 0, 0), abs=1e-12)  # the top of the camera points ahead
