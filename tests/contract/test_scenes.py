"""Contract suite of the built-in scenes."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from factory.scenes.author.scene import BUILTIN_SCENES
from factory.scenes.build import build_scene, package_path
from factory.scenes.rules import builtin_rules
from factory.scenes.topdown import encode_topdown
from schemas.config import CameraConfig, SpawnConfig
from schemas.errors import WorldError
from schemas.scene import CompiledScene, read_scene
from schemas.terms import (
    BUILTIN_CATEGORIES,
    FAR_FLOOR_M,
    PAPER_SCENES,
    Tier,
    family_of,
    layout_name,
    layout_number,
)
from tests.builders.shared import locked
from workers.geometry.camera import optical_pose, projection_matrix, view_matrix
from workers.geometry.grid import CONNECT_CLEARANCE_M, Grid
from workers.geometry.pose import Pose
from workers.render.visible_parts import PartBounds, visible_parts


def pytest_generate_tests(metafunc: pytest.Metafunc) -> None:
    """Selects the scenes of the paper and two layouts; `--scene-seeds N` selects layouts 0 to N - 1 of every family."""
    if "package" in metafunc.fixturenames:
        seeds = range(metafunc.config.getoption("--scene-seeds"))
        families = sorted(BUILTIN_SCENES) if len(seeds) > 1 else ("home", "office")
        layouts = [layout_name(family, seed) for family in families for seed in seeds]
        metafunc.parametrize("package", [*PAPER_SCENES, *layouts], indirect=True)


@pytest.fixture(scope="module")
def package(request: pytest.FixtureRequest, shared: Path, cache: Path) -> Path:
    name: str = request.param
    seed = layout_number(name) or 0
    with locked(shared / f"{name}.lock"):
        try:
            return build_scene(family_of(name), seed, cache / "scenes", called=called(name))
        except WorldError as error:
            if seed == 0:
                raise
            pytest.skip(str(error))


def called(name: str) -> str | None:
    """Returns the name of a numbered layout, `None` for a scene of the paper."""
    return None if layout_number(name) is None else name


@pytest.fixture(scope="module")
def scene(package: Path) -> CompiledScene:
    return read_scene(package)


def test_the_package_is_small_and_at_its_expected_path(package: Path, scene: CompiledScene) -> None:
    name, seed = scene.info.name, int(scene.info.source.rpartition(" ")[2])
    assert package == package_path(family_of(name), seed, package.parent, called=called(name))
    assert package.stat().st_size < 40e6


def test_every_category_of_the_paper_can_be_reached(scene: CompiledScene) -> None:
    seen, held_out = BUILTIN_CATEGORIES[family_of(scene.info.name)]
    assert {target.category for target in scene.info.targets} >= {*seen, *held_out}


def test_every_category_has_a_path_from_near_mid_and_far(scene: CompiledScene) -> None:
    """In layouts of a family, near and far suffice, and paths may bend: rooms are small, and furniture is large."""
    is_family = scene.info.name not in PAPER_SCENES
    ways = {
        (target.category, tier)
        for target in scene.info.targets
        for tier in (target.surface_connected_tiers if is_family else target.straight_tiers)
    }
    categories = {target.category for target in scene.info.targets}
    tiers = (Tier.NEAR, Tier.FAR) if is_family else tuple(Tier)
    assert ways >= {(category, tier) for category in categories for tier in tiers}


def test_every_straight_tier_is_also_a_connected_tier(scene: CompiledScene) -> None:
    for target in scene.info.targets:
        assert set(target.straight_tiers) <= set(target.connected_tiers)
        assert set(target.surface_straight_tiers) <= set(target.surface_connected_tiers)
        is_family = scene.info.name not in PAPER_SCENES  # layouts also have targets too large for success by centroid
        assert Tier.FAR in (target.surface_connected_tiers if is_family else target.connected_tiers)


def test_a_closed_scene_has_no_sky(scene: CompiledScene) -> None:
    assert scene.info.sky is None


def test_at_least_forty_spawns_are_spread_over_the_floor(scene: CompiledScene) -> None:
    assert len(scene.spawns) >= 40
    apart = np.linalg.norm(scene.spawns[:, None] - scene.spawns[None], axis=-1)
    assert (apart + 9 * np.eye(len(apart))).min() >= 0.3
    grid = Grid.from_scene(scene)
    floor = grid.centre_of(np.argwhere(scene.reachable > 0))
    nearest = np.linalg.norm(floor[::7, None] - scene.spawns[None], axis=-1).min(axis=1)
    assert nearest.max() < 4.0


def test_the_robot_fits_at_every_spawn_with_most_headings(scene: CompiledScene) -> None:
    grid, margin = Grid.from_scene(scene), SpawnConfig().margin_m
    yaw = 2 * np.pi * np.arange(16) / 16
    x, y = scene.spawns[:, :1].astype(float), scene.spawns[:, 1:].astype(float)
    assert (grid.are_poses_free(x, y, yaw, margin).sum(axis=1) >= 12).all()


def test_the_reachable_floor_is_free_and_connected(scene: CompiledScene) -> None:
    grid = Grid.from_scene(scene)
    assert (grid.connected_floor() == (scene.reachable > 0)).all()
    assert (grid.clearance[scene.reachable > 0] >= CONNECT_CLEARANCE_M).all()


def test_targets_seen_from_spawns_are_in_range_and_determine_the_straight_far_tier(scene: CompiledScene) -> None:
    distance = np.linalg.norm(
        scene.spawns[:, None] - np.array([target.centroid_m[:2] for target in scene.info.targets])[None], axis=-1
    )
    seen = distance[scene.spawn_sees == 1]
    assert seen.min() >= 1.5 - 1e-6
    assert seen.max() <= 11.0 + 1e-6
    far = {target.target_id for target in scene.info.targets if Tier.FAR in target.straight_tiers}
    columns = ((scene.spawn_sees == 1) & (distance >= FAR_FLOOR_M[0])).any(axis=0)
    assert far == {t.target_id for t, sees in zip(scene.info.targets, columns, strict=True) if sees}


def test_most_objects_have_a_correct_colour(scene: CompiledScene) -> None:
    uncoloured = builtin_rules().uncoloured
    things = [target for target in scene.info.targets if target.category not in uncoloured]
    assert sum(target.colour != "unknown" for target in things) >= 0.8 * len(things)
    assert {target.colour for target in scene.info.targets if target.category in uncoloured} <= {"unknown"}


def test_no_view_exceeds_the_triangle_budget_of_a_frame(scene: CompiledScene) -> None:
    """Counts the front-facing triangles of all parts within the camera's view, including parts behind walls."""
    triangles = scene.positions.reshape(-1, 3, 3).astype(np.float64)
    normals = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
    part = np.repeat(np.arange(len(scene.part_count)), scene.part_count // 3)
    bounds, camera = PartBounds.of(scene), CameraConfig()
    counts = []
    for number, (x, y) in enumerate(scene.spawns[:: max(1, len(scene.spawns) // 16)][:16].tolist()):
        half = np.pi * number * 0.382  # headings in all directions
        pose = Pose(x, y, scene.info.floor_height_m, float(np.cos(half)), 0.0, 0.0, float(np.sin(half)))
        optical = optical_pose(pose, camera)
        seen = visible_parts(bounds, projection_matrix(camera) @ view_matrix(optical), optical.eye)
        facing = np.einsum("tk,tk->t", normals, optical.eye - triangles[:, 0]) > 0
        counts.append(int((facing & np.isin(part, seen)).sum()))
    assert len(counts) == 16
    assert 0 < max(counts) < 15_000


def test_targets_are_listed_in_the_order_of_their_prims(scene: CompiledScene) -> None:
    paths = [target.prim_path for target in scene.info.targets]
    assert paths == sorted(paths)
    assert len({target.target_id for target in scene.info.targets}) == len(paths)


def test_a_second_build_uses_the_cache(package: Path, scene: CompiledScene) -> None:
    before = package.stat().st_mtime_ns
    name, seed = scene.info.name, int(scene.info.source.rpartition(" ")[2])
    assert build_scene(family_of(name), seed, package.parent, called=called(name)) == package
    assert package.stat().st_mtime_ns == before


def test_the_map_is_drawn_as_a_png(scene: CompiledScene) -> None:
    assert encode_topdown(scene).startswith(b"\x89PNG")
