"""Lidar: rays in a known room, mounting, motion during a scan, range limits and noise."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from schemas.rig.noise import LidarNoise
from schemas.rig.sensors import Lidar2d, Lidar3d, Mount
from schemas.scene import CompiledScene
from tests.builders.scene import Box, box_room, build_scene, room_walls
from workers.sensors import LidarScan, NoiseKey, points_of, sense_lidar
from workers.sensors.lidar import noisy_ranges, ray_directions
from workers.sensors.rays import SceneRays

Floats = NDArray[np.float64]
KEY = NoiseKey(1, 2, "lidar")
HZ = 60
QUIET = LidarNoise(range_std_m=0, range_step_m=0, matt_range_m=None)


def lidar2d(**fields: object) -> Lidar2d:
    data = {"name": "lidar", "model": "lidar2d", "samples": 360, "range_min_m": 0.05, "range_max_m": 30}
    return Lidar2d.model_validate(data | {"mount": Mount(z_m=0.3)} | fields)


def lidar3d(**fields: object) -> Lidar3d:
    data = {"name": "lidar", "model": "lidar3d", "samples": 360, "range_min_m": 0.05, "range_max_m": 30}
    lines = {"elevations_deg": tuple(range(15, -16, -2)), "mount": Mount(z_m=0.6)}
    return Lidar3d.model_validate(data | lines | fields)


def standing(x: float = 0.0, y: float = 0.0, yaw: float = 0.0, steps: int = 1) -> Floats:
    return np.tile((x, y, 0, math.cos(yaw / 2), 0, 0, math.sin(yaw / 2)), (steps, 1))


def empty_room() -> SceneRays:
    """A room from (-4, -3) to (4, 3)."""
    return SceneRays(build_scene(room_walls((-4.0, -3.0), (4.0, 3.0))))


def test_a_flat_scan_measures_the_walls_of_a_room() -> None:
    scan = sense_lidar(empty_room(), lidar2d(), standing(x=1.0, yaw=math.pi / 2), 0, HZ, KEY)
    azimuth = math.pi / 2 + np.radians(np.arange(-180, 180))
    x, y = np.cos(azimuth), np.sin(azimuth)
    with np.errstate(divide="ignore"):
        expected = np.minimum(np.where(x > 0, 3, 5) / np.abs(x), 3 / np.abs(y))
    assert scan.ranges[0] == pytest.approx(expected, rel=1e-5)
    assert scan.cosines[0].max() == pytest.approx(1)


def test_points_of_a_scan_are_on_the_surfaces_in_the_sensor_frame() -> None:
    sensor = lidar3d(mount=Mount(x_m=0.2, z_m=0.5, yaw_deg=90))
    scan = sense_lidar(empty_room(), sensor, standing(x=1.0), 0, HZ, KEY)
    points = points_of(scan, sensor)
    x, y, z = 1.2 - points[:, 1], points[:, 0], 0.5 + points[:, 2]  # the sensor looks along y of the world
    on_wall = (np.abs(np.abs(x) - 4) < 1e-4) | (np.abs(np.abs(y) - 3) < 1e-4) | (np.abs(z) < 1e-4)
    above = z > 2.5  # the walls end there, and the room has no ceiling
    assert on_wall.all() or (on_wall | above).all()
    assert len(points) == (scan.ranges > 0).sum()


def test_scan_lines_are_from_top_to_bottom_and_azimuths_counter_clockwise() -> None:
    rays = ray_directions(lidar3d())
    assert rays.shape == (16, 360, 3)
    assert np.degrees(np.arcsin(rays[:, 0, 2])) == pytest.approx(range(15, -16, -2))
    assert rays[0, 180] == pytest.approx((math.cos(math.radians(15)), 0, math.sin(math.radians(15))), abs=1e-12)
    assert rays[0, 270, 1] > 0.9
    assert np.linalg.norm(rays, axis=2) == pytest.approx(1)


def test_ids_are_those_of_the_surfaces_and_0_without_a_return() -> None:
    scene = box_room()
    scan = sense_lidar(SceneRays(scene), lidar3d(range_max_m=3.5), standing(), 0, HZ, KEY)
    known = {instance.id for instance in scene.info.instances}
    assert set(np.unique(scan.ids)) <= known | {0}
    assert ((scan.ids > 0) == (scan.ranges > 0)).all()
    assert len(set(np.unique(scan.ids))) >= 4


def test_returns_outside_of_the_range_are_0() -> None:
    room = empty_room()
    whole = sense_lidar(room, lidar2d(), standing(), 0, HZ, KEY).ranges
    part = sense_lidar(room, lidar2d(range_min_m=3.2, range_max_m=4.0), standing(), 0, HZ, KEY).ranges
    inside = (whole >= 3.2) & (whole <= 4.0)
    assert 0 < inside.mean() < 1
    assert (part == np.where(inside, whole, 0)).all()


# Rendered surfaces ------------------------------------------------------------------------------------------------


def facing(corners: list[tuple[float, float, float]]) -> Floats:
    return np.array(corners)[[0, 1, 2, 0, 2, 3]]


def with_sheet(scene: CompiledScene, *sheets: Floats) -> CompiledScene:
    """Returns a scene with additional parts of six vertices each, as instance 1."""
    count = len(sheets)
    first = len(scene.positions) + 6 * np.arange(count, dtype=np.int32)
    return replace(
        scene,
        positions=np.concatenate((scene.positions, *sheets)).astype(np.float32),
        part_first=np.concatenate((scene.part_first, first)),
        part_count=np.concatenate((scene.part_count, np.full(count, 6, np.int32))),
        part_instance=np.concatenate((scene.part_instance, np.ones(count, np.uint16))),
        part_texture=np.concatenate((scene.part_texture, np.full(count, -1, np.int16))),
    )


SHEET = [(2.0, -1.0, 0.0), (2.0, -1.0, 2.0), (2.0, 1.0, 2.0), (2.0, 1.0, 0.0)]
"""A square across the x axis that is visible from x < 2."""


@pytest.mark.parametrize(
    ("sheets", "expected"),
    [
        pytest.param([SHEET], 2.0, id="front"),
        pytest.param([SHEET[::-1]], 4.0, id="back"),
        pytest.param([SHEET, SHEET[::-1]], 2.0, id="both sides"),
        pytest.param([SHEET[::-1], SHEET[1:] + SHEET[:1]], 2.0, id="both sides, split along the other diagonal"),
        pytest.param([[(x - d, y, z) for x, y, z in SHEET[::-1]] for d in (0, 0.5, 1)], 4.0, id="three backs"),
    ],
)
def test_a_ray_ends_at_a_front_face_and_passes_through_a_back_face(
    sheets: list[list[tuple[float, float, float]]], expected: float
) -> None:
    scene = with_sheet(build_scene(room_walls((-4.0, -3.0), (4.0, 3.0))), *map(facing, sheets))
    scan = sense_lidar(SceneRays(scene), lidar2d(samples=1, azimuth_min_deg=0), standing(), 0, HZ, KEY)
    assert scan.ranges[0, 0] == pytest.approx(expected, abs=1e-5)


def test_tracing_a_ray_that_grazes_back_faces_terminates() -> None:
    backs = [
        facing([(x, y, z + 1e-6 * x) for x, y, z in [(-3, -1, h), (3, -1, h), (3, 1, h), (-3, 1, h)]])
        for h in (0.3,) * 40
    ]
    scene = with_sheet(build_scene(room_walls((-4.0, -3.0), (4.0, 3.0))), *backs)
    scan = sense_lidar(SceneRays(scene), lidar2d(mount=Mount(z_m=0.3000001)), standing(), 0, HZ, KEY)
    assert np.isfinite(scan.ranges).all()


def test_triangles_outside_of_all_parts_are_not_drawn_and_not_hit() -> None:
    scene = build_scene((*room_walls((-4.0, -3.0), (4.0, 3.0)), Box((1.0, -1.0, 0.0), (1.5, 1.0, 1.0))))
    fewer = replace(
        scene, **{name: getattr(scene, name)[:-1] for name in ("part_first", "part_count", "part_instance")}
    )
    sensor = lidar2d(samples=1, azimuth_min_deg=0)
    near, far = (sense_lidar(SceneRays(each), sensor, standing(), 0, HZ, KEY).ranges for each in (scene, fewer))
    assert (near[0, 0], far[0, 0]) == (pytest.approx(1.0), pytest.approx(4.0))


# Motion -----------------------------------------------------------------------------------------------------------


def test_a_scan_of_a_moving_robot_sees_each_direction_from_the_position_at_that_time() -> None:
    steps = np.arange(13)
    poses = standing(steps=13)
    poses[:, 0] = 0.02 * steps  # a speed of 1.2 m/s
    noise = QUIET.model_copy(update={"sweep_s": 0.1})
    scan = sense_lidar(empty_room(), lidar2d(noise=noise), poses, 12, HZ, KEY)
    ahead, behind = scan.ranges[0, 180], scan.ranges[0, 0]
    half_a_turn = 0.02 * 6 * 179 / 360
    assert ahead == pytest.approx(4 - (0.24 - half_a_turn), abs=1e-4)
    assert behind == pytest.approx(4 + 0.24 - 0.02 * 6 * 359 / 360, abs=1e-4)


def test_a_scan_at_rest_does_not_depend_on_the_sweep() -> None:
    noise = QUIET.model_copy(update={"sweep_s": 0.1})
    room, poses = empty_room(), standing(yaw=0.4, steps=20)
    still, swept = (sense_lidar(room, lidar3d(noise=each), poses, 15, HZ, KEY) for each in (None, noise))
    assert swept.ranges == pytest.approx(still.ranges, abs=1e-6)


def test_a_scan_at_the_first_step_assumes_a_robot_at_rest_before_the_start() -> None:
    noise = QUIET.model_copy(update={"sweep_s": 0.1})
    scan = sense_lidar(empty_room(), lidar2d(noise=noise), standing(), 0, HZ, KEY)
    assert scan.ranges[0, 180] == pytest.approx(4.0, abs=1e-5)


# Noise ------------------------------------------------------------------------------------------------------------


def wall_scan(distance: float, cosine: float = 1.0, rays: int = 40_000) -> LidarScan:
    shape = (1, rays)
    return LidarScan(
        np.full(shape, distance, np.float32), np.ones(shape, np.uint16), np.full(shape, cosine, np.float32)
    )


@pytest.mark.parametrize(("constant", "share"), [(0.02, 0.0), (0.0, 0.01), (0.03, 0.01)])
def test_range_noise_is_the_sum_of_a_constant_and_a_proportional_part(constant: float, share: float) -> None:
    noise = LidarNoise(range_std_m=constant, range_std_share=share, range_step_m=0, matt_range_m=None)
    errors = noisy_ranges(wall_scan(5.0), noise, KEY, 0) - 5
    assert errors.std() == pytest.approx(math.hypot(constant, 5 * share), rel=0.02)
    assert errors.mean() == pytest.approx(0, abs=5e-4)


def test_ranges_are_multiples_of_the_resolution() -> None:
    ranges = noisy_ranges(wall_scan(5.0), LidarNoise(range_step_m=0.002), KEY, 0).astype(np.float64)
    assert np.abs(ranges / 0.002 - np.rint(ranges / 0.002)).max() < 1e-3
    assert len(np.unique(ranges)) > 10


def test_the_share_of_lost_rays_is_the_parameter() -> None:
    noise = LidarNoise(dropout=0.2)
    assert (noisy_ranges(wall_scan(5.0), noise, KEY, 0) == 0).mean() == pytest.approx(0.2, abs=0.01)


@pytest.mark.parametrize(
    ("distance", "incidence_deg", "is_seen"), [(9.9, 0, True), (10.1, 0, False), (7.0, 60, True), (7.2, 60, False)]
)
def test_a_weak_return_is_lost(distance: float, incidence_deg: float, is_seen: bool) -> None:
    noise = LidarNoise(matt_range_m=10.0)
    scan = wall_scan(distance, math.cos(math.radians(incidence_deg)))
    assert ((noisy_ranges(scan, noise, KEY, 0) > 0) == is_seen).all()


def test_noise_depends_on_the_step_and_not_on_the_order_of_calls() -> None:
    noise, scan = LidarNoise(dropout=0.1), wall_scan(5.0)
    third = noisy_ranges(scan, noise, KEY, 3)
    assert (noisy_ranges(scan, noise, KEY, 4) != third).any()
    assert (noisy_ranges(scan, noise, KEY, 3) == third).all()
