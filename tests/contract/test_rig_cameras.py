"""Contract suite of the cameras of rigs: every renderer, every camera model, against geometry and OpenCV."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import cv2
import numpy as np
import pytest

from schemas.config import CameraConfig
from schemas.errors import UsageError
from schemas.rig import Camera, CameraOutput, EquirectangularCamera, FisheyeCamera, Mount, PinholeCamera
from schemas.rig.rig_file import load_rig
from schemas.scene import TEXTURE_SIZE_PX, CompiledScene, Sky
from schemas.support.numpy_types import Floats
from tests.builders.scene import Box, build_scene, room_walls
from tests.contract.conftest import one_thread
from workers.geometry.camera import mounted_pose
from workers.geometry.faces import plan_faces
from workers.geometry.lens import pixel_centres, project, unproject
from workers.geometry.pose import Pose
from workers.render import Renderer
from workers.render.choose import open_renderer

POSE = Pose.planar(0.4, -0.3, 0.7)
MOUNT = Mount(x_m=0.1, y_m=0.2, z_m=0.8, yaw_deg=40, pitch_deg=10, roll_deg=-5)
LOW, HIGH = np.array((-4.0, -3.0, 0.0)), np.array((4.0, 3.0, 2.5))
CAMERAS = [
    PinholeCamera(name="wide", model="pinhole", width=120, height=70, fx_px=55, fy_px=60, cx_px=50, cy_px=40),
    PinholeCamera(
        name="distorted", model="pinhole", width=120, height=90, fov_deg=80, distortion=(-0.2, 0.05, 0.001, 0.002, 0.0)
    ),
    PinholeCamera(name="radial", model="pinhole", width=64, height=48, fov_deg=90, depth="radial"),
    FisheyeCamera(name="eye", model="fisheye", width=120, height=110, fov_deg=200, distortion=(-0.01, 0.002, 0, 0)),
    EquirectangularCamera(name="panorama", model="equirectangular", width=128, height=64),
    EquirectangularCamera(name="band", model="equirectangular", width=160, height=30, top_deg=20, bottom_deg=-30),
]
EVERY_CAMERA = pytest.mark.parametrize("camera", [pytest.param(camera, id=camera.name) for camera in CAMERAS])


@pytest.fixture(scope="module")
def gl() -> Iterator[Renderer]:
    with one_thread("gl", apart=False) as opened:
        yield opened


def closed_room(*boxes: Box) -> CompiledScene:
    """A room with the inner corners LOW and HIGH and a chequered ceiling."""
    rows, columns = np.mgrid[:TEXTURE_SIZE_PX, :TEXTURE_SIZE_PX] // 64
    board = np.where((rows + columns)[..., None] % 2, 255, 80).astype(np.uint8)
    ceiling = Box((-4.2, -3.2, 2.5), (4.2, 3.2, 2.6), (250, 250, 250), texture=0)
    walls = room_walls((-4.0, -3.0), (4.0, 3.0))
    textures = np.broadcast_to(board, (1, TEXTURE_SIZE_PX, TEXTURE_SIZE_PX, 3))
    return build_scene((*walls, ceiling, *boxes), textures=textures)


def mounted(camera: Camera, **changes: object) -> Camera:
    return camera.model_copy(update={"mount": MOUNT, **changes})


def rays_in_world(camera: Camera) -> tuple[Floats, Floats]:
    """Returns the eye (3,) and the unit rays (H, W, 3) of a camera at POSE in the world; NaN if a pixel has no ray."""
    optical = mounted_pose(POSE, camera.mount)
    return optical.eye, unproject(camera, pixel_centres(camera)) @ optical.rotation.T


def distances_in_room(eye: Floats, rays: Floats) -> tuple[Floats, Floats]:
    """Returns the distances (H, W) to the walls, floor and ceiling of the room, and their normals (H, W, 3)."""
    with np.errstate(divide="ignore", invalid="ignore"):
        along = (np.where(rays > 0, HIGH, LOW) - eye) / rays
    nearest = np.nan_to_num(along, nan=np.inf).argmin(axis=-1)
    distance = np.take_along_axis(along, nearest[..., None], axis=-1)[..., 0]
    return distance, -np.sign(rays) * (np.arange(3) == nearest[..., None])


@EVERY_CAMERA
def test_depth_is_the_distance_to_the_walls(renderer: Renderer, camera: Camera):
    camera = mounted(camera)
    renderer.load(closed_room(), CameraConfig())
    image = renderer.render_camera(camera, POSE)
    eye, rays = rays_in_world(camera)
    distance, _ = distances_in_room(eye, rays)
    seen = ~np.isnan(rays[..., 0])
    share = unproject(camera, pixel_centres(camera))[..., 2] if camera.depth == "axial" else 1.0
    error = np.abs(image.depth - distance * share)[seen] / distance[seen]
    assert np.median(error) < 0.005
    assert np.quantile(error, 0.99) < 0.1  # larger at grazing angles, because the nearest pixel of a face is used
    assert (image.depth[~seen] == 0).all()
    assert (image.ids[~seen] == 0).all()
    assert (image.rgb[~seen] == 0).all()
    assert image.rgb.shape == (camera.height, camera.width, 3)
    assert all(array.flags.c_contiguous for array in (image.rgb, image.depth, image.ids))


@EVERY_CAMERA
def test_a_small_object_is_where_the_camera_model_projects_it(renderer: Renderer, camera: Camera):
    camera = mounted(camera)
    where = np.array((2.0, 2.0, 1.0))
    speck = Box(tuple(where - 0.12), tuple(where + 0.12), (255, 0, 0))
    scene = closed_room(speck)
    renderer.load(scene, CameraConfig())
    rows, columns = np.nonzero(renderer.render_camera(camera, POSE).ids == len(scene.info.instances))
    optical = mounted_pose(POSE, camera.mount)
    expected = project(camera, (where - optical.eye) @ optical.rotation)
    assert len(rows) >= 4
    assert (columns.mean() + 0.5, rows.mean() + 0.5) == pytest.approx(expected, abs=1.0)


def test_the_rig_named_paper_gives_the_frames_of_the_robots_camera(renderer: Renderer):
    room = build_scene(room_walls((-4.0, -3.0), (4.0, 3.0)))
    renderer.load(replace(room, info=room.info.model_copy(update={"sky": Sky()})), CameraConfig())
    frame = renderer.render(POSE, 640)
    image = renderer.render_camera(load_rig("paper").cameras[0], POSE)
    assert np.array_equal(frame.rgb, image.rgb)
    assert np.array_equal(frame.depth, image.depth)
    assert np.array_equal(frame.ids, image.ids)


@pytest.mark.gl
@EVERY_CAMERA
def test_normals_are_those_of_the_walls_in_the_optical_frame(gl: Renderer, camera: Camera):
    camera = mounted(camera, outputs=(CameraOutput.NORMALS,))
    gl.load(closed_room(), CameraConfig())
    image = gl.render_camera(camera, POSE)
    eye, rays = rays_in_world(camera)
    _, expected = distances_in_room(eye, rays)
    local = np.nan_to_num(expected) @ mounted_pose(POSE, camera.mount).rotation
    assert image.normals is not None
    agreement = (image.normals * local).sum(axis=-1)[image.depth > 0]
    assert np.quantile(agreement, 0.05) > 0.999  # within 2.6 degrees; 5 % may differ more, at the corners of the room
    assert (image.normals[image.depth == 0] == 0).all()


def test_tiny_renderer_refuses_normals():
    with open_renderer("tiny") as tiny:
        tiny.load(closed_room(), CameraConfig())
        with pytest.raises(UsageError, match=r"no normals: use the renderer gl"):
            tiny.render_camera(mounted(CAMERAS[0], outputs=(CameraOutput.NORMALS,)), POSE)


@pytest.mark.gl
def test_opencv_undistorts_a_distorted_image_to_that_of_a_camera_without_distortion(gl: Renderer):
    straight = mounted(PinholeCamera(name="straight", model="pinhole", width=320, height=240, fov_deg=80))
    bent = straight.model_copy(update={"distortion": (-0.15, 0.03, 0.002, -0.001, 0.0)})
    gl.load(closed_room(), CameraConfig())
    (fx, fy), (cx, cy) = bent.focal_px, bent.centre_px
    matrix = np.array(((fx, 0, cx - 0.5), (0, fy, cy - 0.5), (0, 0, 1)))
    undistorted = cv2.undistort(gl.render_camera(bent, POSE).rgb, matrix, np.array(bent.distortion))
    expected = gl.render_camera(straight, POSE).rgb
    inner = np.s_[30:-30, 40:-40]
    shift, _ = cv2.phaseCorrelate(*(_grey(image[inner]) for image in (undistorted, expected)))
    assert shift == pytest.approx((0, 0), abs=0.1)
    assert np.abs(undistorted[inner].astype(int) - expected[inner]).mean() < 3


@pytest.mark.gl
def test_opencv_rectifies_our_fisheye_image_to_a_pinhole_image(gl: Renderer):
    eye = mounted(
        FisheyeCamera(
            name="eye", model="fisheye", width=400, height=400, fov_deg=190, distortion=(-0.02, 0.004, -0.001, 0.0)
        )
    )
    straight = mounted(PinholeCamera(name="straight", model="pinhole", width=320, height=240, fov_deg=80))
    gl.load(closed_room(), CameraConfig())
    bent, straightened = (
        np.array(((fx, 0, cx - 0.5), (0, fy, cy - 0.5), (0, 0, 1)))
        for (fx, fy), (cx, cy) in ((camera.focal_px, camera.centre_px) for camera in (eye, straight))
    )
    undistorted = cv2.fisheye.undistortImage(
        gl.render_camera(eye, POSE).rgb, bent, np.array(eye.distortion), Knew=straightened, new_size=(320, 240)
    )
    expected = gl.render_camera(straight, POSE).rgb
    inner = np.s_[20:-20, 20:-20]
    soft = [cv2.GaussianBlur(_grey(image), (0, 0), 2) for image in (undistorted, expected)]
    shift, _ = cv2.phaseCorrelate(*(image[inner] for image in soft))
    assert shift == pytest.approx((0, 0), abs=0.1)
    assert np.abs(soft[0] - soft[1])[inner].mean() < 3


def _grey(image: np.ndarray) -> np.ndarray:
    return cv2.cvtColor(np.ascontiguousarray(image), cv2.COLOR_RGB2GRAY).astype(np.float64)


@pytest.mark.gl
def test_the_left_camera_of_a_stereo_pair_sees_objects_further_to_the_right(gl: Renderer):
    left, right = load_rig("nova-carter").cameras[:2]
    scene = closed_room(Box((3.0, -0.3, 0.1), (3.2, 0.3, 0.6), (255, 0, 0)))
    gl.load(scene, CameraConfig())
    middles = []
    for camera in (left, right):
        image = gl.render_camera(camera, Pose.planar(0.0, 0.0, 0.0))
        middles.append(np.nonzero(image.ids == len(scene.info.instances))[1].mean())
    disparity = left.focal_px[0] * 0.15 / (3.0 - 0.1003)
    assert middles[0] - middles[1] == pytest.approx(disparity, abs=1.0)


@pytest.mark.gl
def test_opencv_measures_the_depth_of_a_stereo_pair(gl: Renderer):
    spots = np.random.default_rng(5).integers(0, 255, (1, 64, 64, 1), np.uint8)
    texture = np.repeat(spots.repeat(TEXTURE_SIZE_PX // 64, 1).repeat(TEXTURE_SIZE_PX // 64, 2), 3, axis=3)
    white = (255, 255, 255)
    wall = Box((2.5, -6.0, -1.0), (2.6, 6.0, 4.0), white, texture=0)
    box = Box((1.6, -0.4, 0.0), (1.9, 0.3, 0.6), white, texture=0)
    gl.load(build_scene((wall, box), textures=texture), CameraConfig())
    pair = [
        camera.model_copy(update={"width": 320, "height": 200, "fx_px": 160.0})
        for camera in load_rig("nova-carter").cameras[:2]
    ]
    left, right = (gl.render_camera(camera, Pose.planar(0.0, 0.0, 0.0)) for camera in pair)
    matcher = cv2.StereoSGBM_create(numDisparities=32, blockSize=7, uniquenessRatio=5)
    disparity = matcher.compute(_grey(left.rgb).astype(np.uint8), _grey(right.rgb).astype(np.uint8)) / 16
    expected = 160.0 * 0.15 / np.where(left.depth > 0, left.depth, np.inf)
    found = (disparity > 0) & (left.depth > 0)
    assert found.mean() > 0.6
    assert np.median(np.abs(disparity - expected)[found]) < 0.25
    assert (np.abs(disparity - expected)[found] < 1).mean() > 0.95


@pytest.mark.parametrize("camera", [pytest.param(each, id=each.name) for each in CAMERAS if each.name != "wide"])
def test_no_face_has_coarser_pixels_than_the_image(camera: Camera):
    plan = plan_faces(camera)
    rays = unproject(camera, pixel_centres(camera))
    middle = camera.height // 2, camera.width // 2
    step = np.linalg.norm(rays[middle] - rays[middle[0], middle[1] + 1])  # angle between pixels in the middle, rad
    assert all(min(face.view.focal_px) >= 0.99 / step for face in plan.faces)


@pytest.mark.gl
def test_a_panorama_has_no_seam_between_its_faces(gl: Renderer):
    camera = mounted(EquirectangularCamera(name="panorama", model="equirectangular", width=256, height=128))
    inside, outside = np.full((6, 3), -3.0), np.full((6, 3), 3.0)
    for axis in range(3):
        outside[2 * axis, axis], inside[2 * axis + 1, axis] = -2.9, 2.9
    sides = [Box(tuple(low), tuple(high)) for low, high in zip(inside.tolist(), outside.tolist(), strict=True)]
    gl.load(build_scene(sides), CameraConfig())
    image = gl.render_camera(camera, POSE)
    assert (image.depth > 0).all()
    assert (image.rgb == image.rgb[0, 0]).all()  # the room has one colour, which must not change at the edges of faces
