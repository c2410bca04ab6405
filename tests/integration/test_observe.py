"""Measurements of the sensors of a rig, computed from the recorded poses when an episode is read."""

from __future__ import annotations

import pickle
from pathlib import Path

import cv2
import numpy as np
import pytest
from PIL import Image

from factory.dataset.bundle import EpisodeBundle
from factory.dataset.reader import Dataset
from factory.visualize.rig_sheet import draw_rig_sheet
from schemas.errors import InvalidRig, UsageError
from schemas.rig import (
    Camera,
    CameraOutput,
    DepthKind,
    EquirectangularCamera,
    FisheyeCamera,
    Imu,
    Lidar2d,
    Mount,
    PinholeCamera,
    Rig,
    WheelOdometry,
)
from schemas.rig.noise import CameraNoise, ColourNoise, LidarNoise
from schemas.terms import Recording
from workers.geometry.camera import mounted_pose
from workers.geometry.lens import pixel_centres, unproject
from workers.geometry.pose import Pose
from workers.sensors import CameraMeasurement

pytestmark = pytest.mark.gl

MOUNT = Mount(x_m=0.2, z_m=0.5)
FRONT = PinholeCamera(
    name="front", model="pinhole", mount=MOUNT, rate_hz=10, width=96, height=64, fov_deg=90,
    outputs=("rgb", "depth", "ids", "normals", "flow"),
)  # fmt: skip
EYE = FisheyeCamera(name="eye", model="fisheye", mount=MOUNT, width=64, height=64, fov_deg=190, outputs=("depth",))
AROUND = EquirectangularCamera(name="around", model="equirectangular", mount=MOUNT, width=64, height=32)
LIDAR = Lidar2d(name="scan", model="lidar2d", mount=MOUNT, rate_hz=5, samples=90, range_min_m=0.1, range_max_m=20)
IMU = Imu(name="imu", model="imu", mount=MOUNT)
WHEELS = WheelOdometry(name="wheels", model="odometry")
RIG = Rig(name="all", sensors=(FRONT, EYE, AROUND, LIDAR, IMU, WHEELS))


@pytest.fixture
def data(recordings: dict[Recording, Path]) -> Dataset:
    return Dataset(recordings[Recording.STATES], rig=RIG)


def camera_of(found: object) -> CameraMeasurement:
    assert isinstance(found, CameraMeasurement)
    return found


@pytest.mark.parametrize("record", list(Recording))
def test_the_rig_named_paper_shows_the_frames_of_the_dataset(recordings: dict[Recording, Path], record: Recording):
    episode = Dataset(recordings[record], rig="paper")[0]
    seen, frame = camera_of(episode.observe(5)["front"]), episode.frame(5)
    for name in ("rgb", "depth", "ids"):
        assert np.array_equal(getattr(seen, name), getattr(frame, name))


def test_each_sensor_measures_at_its_rate(data: Dataset):
    episode = data[0]
    assert set(episode.observe(0)) == {"front", "eye", "around", "scan"}
    assert set(episode.observe(3)) == {"front", "eye", "around"}
    assert set(episode.observe(4)) == {"eye", "around"}
    assert set(episode.observe(6, ["scan"])) == {"scan"}
    assert set(episode.motion()) == {"imu", "wheels"}


def test_a_camera_gives_only_its_outputs(data: Dataset):
    found = data[0].observe(0)
    assert [image is None for image in camera_of(found["eye"])] == [True, False, True, True, True]
    shapes = [image.shape for image in camera_of(found["front"]) if image is not None]
    assert shapes == [(64, 96, 3), (64, 96), (64, 96), (64, 96, 3), (64, 96, 2)]


def test_the_flow_leads_to_the_same_point_in_the_next_image(data: Dataset):
    episode = data[0]
    first, second = camera_of(episode.observe(30)["front"]), camera_of(episode.observe(33)["front"])
    assert first.flow is not None
    assert first.ids is not None
    assert second.ids is not None
    rows, columns = np.mgrid[:64, :96]
    places = np.floor(np.stack((columns, rows), axis=-1) + 0.5 + first.flow)
    inside = ((places >= 0) & (places < (96, 64))).all(axis=-1)
    there = places[inside].astype(int)
    assert inside.mean() > 0.5
    assert (second.ids[there[:, 1], there[:, 0]] == first.ids[inside]).mean() > 0.97


@pytest.mark.parametrize("camera", [FRONT, EYE, AROUND], ids=["pinhole", "fisheye", "panorama"])
def test_a_later_depth_image_warped_by_the_flow_shows_the_surfaces_of_the_earlier_image(
    recordings: dict[Recording, Path], camera: Camera
):
    """Warps the later depth image by the flow with OpenCV and compares it with distances computed from the poses."""
    outputs = (CameraOutput.DEPTH, CameraOutput.FLOW, CameraOutput.IDS)
    size = {"width": 4 * camera.width, "height": 4 * camera.height}
    lens = camera.model_copy(update={"rate_hz": 5.0, "outputs": outputs, "depth": DepthKind.RADIAL, **size})
    episode = Dataset(recordings[Recording.STATES], rig=Rig(name="flow", sensors=(lens,)))[0]
    first, later = (camera_of(episode.observe(t)[lens.name]) for t in (30, 36))
    assert first.flow is not None
    now, then = (mounted_pose(Pose.of(episode.poses[t]), MOUNT) for t in (30, 36))
    points = now.eye + (unproject(lens, pixel_centres(lens)) * first.depth[..., None]) @ now.rotation.T
    expected = np.linalg.norm(points - then.eye, axis=-1)
    rows, columns = np.mgrid[: lens.height, : lens.width].astype(np.float32)
    places = columns + first.flow[..., 0], rows + first.flow[..., 1]
    warped, ids = (cv2.remap(image, *places, cv2.INTER_NEAREST) for image in (later.depth, later.ids))
    seen = (first.depth > 0) & (ids == first.ids) & (warped > 0)
    assert seen.mean() > 0.3
    assert np.median(np.abs(warped - expected)[seen] / expected[seen]) < 0.005
    assert (np.abs(warped - expected)[seen] < 0.05 * expected[seen]).mean() > 0.95
    assert np.median(np.abs(first.depth - expected)[seen]) > 0.03  # the robot has moved


def test_the_last_image_has_no_flow(data: Dataset):
    episode = data[0]
    last = (len(episode) - 1) // 3 * 3
    assert camera_of(episode.observe(last)["front"]).flow is None


def test_lidar_and_depth_agree_straight_ahead(data: Dataset):
    found = data[0].observe(0)
    ahead = found["scan"].ranges[0, 45]  # type: ignore[union-attr]
    depth = camera_of(found["front"]).depth
    assert depth is not None
    assert ahead == pytest.approx(depth[31:33, 47:49].mean(), abs=0.05)


def test_noise_changes_a_measurement_and_does_not_depend_on_the_order_of_reading(recordings: dict[Recording, Path]):
    noisy = FRONT.model_copy(
        update={"noise": CameraNoise(colour=ColourNoise(motion_blur_s=0.03)), "outputs": (CameraOutput.RGB,)}
    )
    scan = LIDAR.model_copy(update={"noise": LidarNoise()})
    episodes = [Dataset(recordings[Recording.STATES], rig=Rig(name="n", sensors=(noisy, scan)))[0] for _ in range(2)]
    forward = [episodes[0].observe(t) for t in (0, 6, 12)]
    backward = [episodes[1].observe(t) for t in (12, 6, 0)][::-1]
    clean = Dataset(recordings[Recording.STATES], rig=RIG)[0].observe(6)
    for one, other in zip(forward, backward, strict=True):
        assert np.array_equal(camera_of(one["front"]).rgb, camera_of(other["front"]).rgb)
        assert np.array_equal(one["scan"].ranges, other["scan"].ranges)  # type: ignore[union-attr]
    assert not np.array_equal(camera_of(forward[1]["front"]).rgb, camera_of(clean["front"]).rgb)
    assert not np.array_equal(forward[1]["scan"].ranges, clean["scan"].ranges)  # type: ignore[union-attr]


def test_a_filtered_dataset_and_a_pickled_episode_keep_the_rig(data: Dataset):
    episode = pickle.loads(pickle.dumps(data.filter(split="train_id")[0]))
    assert episode.rig == RIG
    assert set(episode.observe(1)) == {"eye", "around"}


def test_an_episode_without_a_rig_and_an_unknown_sensor_are_refused(recordings: dict[Recording, Path], data: Dataset):
    with pytest.raises(UsageError, match="has no rig: open the dataset as Dataset"):
        Dataset(recordings[Recording.STATES])[0].observe(0)
    with pytest.raises(UsageError, match=r"rig 'all' has no sensor 'fornt'.*did you mean 'front'"):
        data[0].observe(0, ["fornt"])
    with pytest.raises(UsageError, match=r"no rig 'papr'.*did you mean 'paper'"):
        Dataset(recordings[Recording.STATES], rig="papr")
    slow = Rig(name="slow", sensors=(FRONT.model_copy(update={"rate_hz": 7.0}),))
    with pytest.raises(InvalidRig, match="rate_hz 7 does not divide the control rate, 30 Hz"):
        Dataset(recordings[Recording.STATES], rig=slow)


def test_the_sheet_of_a_rig_has_a_row_for_each_camera_and_lidar(data: Dataset):
    with data[0].path.open("rb") as file:
        sheet = draw_rig_sheet(EpisodeBundle(file, data.root), RIG, columns=2)
    assert sheet.size == (6 * 240, 4 * 20 + 160 + 240 + 120 + 240)  # the first camera also has flow and normals
    scan = np.asarray(sheet)[-240:, :480].reshape(240, 2, 240, 3)
    assert ((scan != 255).any(axis=(0, 2, 3))).all()
    assert len(np.unique(np.asarray(sheet.convert("L")))) > 20


def test_factory_show_draws_the_cameras_of_a_rig(recordings: dict[Recording, Path], tmp_path: Path):
    from click.testing import CliRunner

    from factory.cli.show import command

    run = CliRunner(catch_exceptions=False)
    root = str(recordings[Recording.STATES])
    out = tmp_path / "sheet.png"
    assert run.invoke(command, [root, "1", "--rig", "turtlebot4", "--columns", "2", "-o", str(out)]).exit_code == 0
    with Image.open(out) as sheet:
        assert sheet.size == (4 * 240, 3 * (20 + 180) + 20 + 240)
    with pytest.raises(UsageError, match=r"--rig draws a contact sheet: choose a file that ends in \.png"):
        run.invoke(command, [root, "1", "--rig", "paper", "-o", str(tmp_path / "film.mp4")])
