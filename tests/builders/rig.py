"""A small rig with one sensor of each model, its exports, and a check of points against a depth image."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import cv2
import numpy as np
from scipy.spatial.transform import Rotation

from factory.dataset.episode import Episode
from factory.export.execution.export_run import ExportOrder, run_export
from factory.export.registry import find_exporter
from schemas.rig import (
    EquirectangularCamera,
    FisheyeCamera,
    Imu,
    Lidar2d,
    Lidar3d,
    Mount,
    PinholeCamera,
    Rig,
    WheelOdometry,
)
from tests.builders.driven import CONTROL_HZ

ID = "ep_000001"
MOUNT = Mount(x_m=0.2, y_m=0.1, z_m=0.5, yaw_deg=20, pitch_deg=5, roll_deg=-3)
FRONT = PinholeCamera(
    name="front", model="pinhole", mount=MOUNT, rate_hz=10, width=96, height=64, fx_px=70, cx_px=50, cy_px=30,
    distortion=(-0.1, 0.02, 0.001, -0.002, 0.0), outputs=("rgb", "depth", "ids", "normals", "flow"),
)  # fmt: skip
EYE = FisheyeCamera(
    name="eye", model="fisheye", mount=MOUNT, width=64, height=64, fov_deg=180, distortion=(0.01, 0, 0, 0), rate_hz=15
)
AROUND = EquirectangularCamera(
    name="around", model="equirectangular", mount=Mount(z_m=1), width=64, height=32, rate_hz=5, outputs=("rgb",)
)
SCAN = Lidar2d(name="scan", model="lidar2d", mount=MOUNT, rate_hz=6, samples=90, range_min_m=0.1, range_max_m=2.5)
CLOUD = Lidar3d(
    name="cloud", model="lidar3d", mount=Mount(x_m=0.1, z_m=0.6, yaw_deg=90), rate_hz=5, samples=180,
    elevations_deg=(10, 0, -10, -20), range_min_m=0.1, range_max_m=20,
)  # fmt: skip
IMU = Imu(name="imu", model="imu", mount=Mount(z_m=0.2), rate_hz=15)
WHEELS = WheelOdometry(name="wheels", model="odometry")
RIG = Rig(name="all", sensors=(FRONT, EYE, AROUND, SCAN, CLOUD, IMU, WHEELS))
FPS, STRIDE = 5, 6
FORMATS: dict[str, dict[str, Any]] = {
    "lerobot": {"depth": True, "ids": True, "fps": FPS},
    "lerobot-v2.1": {"fps": FPS},
    "webdataset": {"fps": FPS},
    "paper": {},
    "mcap": {"fps": FPS},
}


def export_rig(root: Path, out: Path, name: str, rig: Rig | str | None = RIG, **options: Any) -> Path:
    """Exports the episode `ID` with a rig; returns the folder of the export."""
    chosen = find_exporter(name).options.model_validate(options)
    assert run_export(ExportOrder(root, out, name, chosen, episodes=(ID,), rig=rig)).complete
    return out


def seen(episode: Episode, name: str, t: int) -> Any:
    """Returns the measurement of a camera or lidar at step t."""
    return episode.observe(t, [name])[name]


def latest(sensor: Any, t: int) -> int:
    """Returns the step of the latest measurement of a sensor at or before step t."""
    return t - t % sensor.stride(CONTROL_HZ)


def rotation_of(pose: list[float]) -> Rotation:
    return Rotation.from_quat(pose[3:], scalar_first=True)


def assert_depth_agrees(camera: dict[str, Any], base: np.ndarray, depth: np.ndarray, *, is_radial: bool) -> None:
    """Compares points (N, 3) in base_link with the depth at the pixels onto which OpenCV projects them."""
    turn = rotation_of(camera["pose"]) * Rotation.from_quat([0.5, -0.5, 0.5, -0.5], scalar_first=True)
    optical = turn.inv().apply(base - camera["pose"][:3])
    matrix = np.reshape(camera["camera_matrix"], (3, 3))
    project = cv2.fisheye.projectPoints if camera["distortion_model"] == "cv2.fisheye" else cv2.projectPoints
    ahead = optical[optical[:, 2] > 0.1]
    still = np.zeros(3)
    distortion = np.asarray(camera["distortion"])
    if project is cv2.projectPoints:
        pixels = project(ahead, still, still, matrix, distortion)[0].reshape(-1, 2)
    else:
        pixels = project(ahead[:, None], still, still, matrix, distortion)[0].reshape(-1, 2)
    columns, rows = np.rint(pixels).astype(int).T
    inside = (columns >= 1) & (rows >= 1) & (columns < depth.shape[1] - 1) & (rows < depth.shape[0] - 1)
    expected = (np.linalg.norm(ahead, axis=1) if is_radial else ahead[:, 2])[inside]
    found = depth[rows[inside], columns[inside]]
    assert inside.sum() > 30
    assert np.median(np.abs(found - expected) / expected) < 0.01
    assert (np.abs(found - expected) < 0.1 * expected).mean() > 0.9  # the other points are next to an edge
