"""A public USD world: the AWS RoboMaker small warehouse, compared with its SLAM map."""

from __future__ import annotations

import io
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from scipy.ndimage import distance_transform_edt

from factory.scenes.compile.compiler import compile_stage
from schemas.scene import CompiledScene, decode_scene, encode_scene
from workers.geometry.grid import Grid

WORLD = Path(__file__).resolve().parents[3] / "shared" / "scenes" / "aws_small_warehouse"
MAP_ORIGIN_M = (-7.0, -10.5)
OCCUPIED_GRAY = 255 * 0.35  # map.yaml: occupied_thresh 0.65

pytestmark = pytest.mark.skipif(not WORLD.is_dir(), reason="the AWS world is not in ../shared/scenes")


@pytest.fixture(scope="module")
def warehouse() -> CompiledScene:
    return compile_stage(WORLD / "world.usda", "aws_small_warehouse", "world.usda")


def slam_points() -> np.ndarray:
    """Returns the (N, 2) centres of the occupied cells of the SLAM map, metres."""
    picture = np.flipud(np.asarray(Image.open(WORLD / "maps" / "map_rotated.png").convert("L")))
    cells = np.argwhere(picture < OCCUPIED_GRAY)
    return (cells[:, ::-1] + 0.5) * 0.05 + MAP_ORIGIN_M


def share_explained(grid: Grid, points: np.ndarray, yaw: float, shift: np.ndarray) -> float:
    """Returns the share of the points within 0.10 m of an occupied cell after a rigid transform."""
    turn = np.array([[np.cos(yaw), -np.sin(yaw)], [np.sin(yaw), np.cos(yaw)]])
    distance = distance_transform_edt(grid.occupancy == 0) * grid.resolution_m
    return float((grid.values_at(distance, points @ turn.T + shift, 9.0) <= 0.10).mean())


def test_the_slam_map_agrees_after_a_small_rigid_fit(warehouse: CompiledScene) -> None:
    grid, points = Grid.from_scene(warehouse), slam_points()
    yaws = np.radians(np.arange(-0.6, 0.61, 0.3))
    shifts = [np.array([x, y]) for x in np.arange(0.0, 0.2, 0.04) for y in np.arange(0.0, 0.2, 0.04)]
    best = max(share_explained(grid, points, yaw, shift) for yaw in yaws for shift in shifts)
    assert best >= 0.97


def test_shelves_the_pallet_jack_and_the_trash_can_are_targets(warehouse: CompiledScene) -> None:
    found = [target.target_id for target in warehouse.info.targets]
    assert found == ["pallet_jack_001"] + [f"shelf_{number:03d}" for number in range(1, 7)] + ["trash_can_001"]
    colours = {target.target_id: target.colour for target in warehouse.info.targets}
    assert colours["trash_can_001"] == "green"


def test_the_warehouse_without_a_roof_has_a_sky(warehouse: CompiledScene) -> None:
    assert warehouse.info.sky is not None


def test_the_warehouse_survives_a_round_trip(warehouse: CompiledScene) -> None:
    data = encode_scene(warehouse)
    assert len(data) < 40e6
    assert encode_scene(decode_scene(io.BytesIO(data))) == data


def test_authored_collision_shapes_replace_the_render_meshes(warehouse: CompiledScene) -> None:
    assert 1000 < len(warehouse.collider_triangles) < 2000
    assert len(warehouse.positions) / 3 > 20000


def test_the_floor_is_at_the_height_where_the_robot_drives(warehouse: CompiledScene) -> None:
    assert warehouse.info.floor_height_m == pytest.approx(0.034, abs=0.005)
    assert warehouse.info.free_area_m2 > 150
    assert len(warehouse.spawns) >= 40
