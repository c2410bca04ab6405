"""Drawn factors: seeds, materials with true colour names, clutter off the path, cameras."""

from __future__ import annotations

import math
from functools import cache

import numpy as np
import pytest

from schemas.appearance import (
    Appearance,
    CameraChange,
    CameraRanges,
    ClutterRanges,
    LightRanges,
    MaterialRanges,
)
from schemas.config import CameraConfig
from schemas.errors import UsageError, WorldError
from schemas.rig import Mount, PinholeCamera
from schemas.scene import Target
from schemas.support.numpy_types import Floats
from tests.builders.lit import lit_room, room_light
from workers.appearance import (
    AppearanceScene,
    apply_appearance,
    changed_camera,
    clutter_instances,
    draw_appearance,
    recorded_camera,
)
from workers.appearance.clutter import RADII
from workers.appearance.materials import SceneSurfaces
from workers.geometry.grid import DISC_OFFSETS_M

FULL = Appearance(light=LightRanges(), materials=MaterialRanges(), camera=CameraRanges(), clutter=ClutterRanges())


@cache
def place() -> AppearanceScene:
    return AppearanceScene(lit_room(), room_light())


def target() -> Target:
    return lit_room().info.targets[0]


def drive() -> Floats:
    """A straight drive along x towards the crate."""
    poses = np.zeros((40, 7))
    poses[:, 0], poses[:, 1], poses[:, 3] = np.linspace(-1.5, 1.2, 40), 0.6, 1.0
    return poses


def drawn(ranges: Appearance = FULL, seed: int = 1, episode: int = 1):
    return draw_appearance(ranges, seed, episode, place(), target(), drive())


def test_factors_depend_on_seed_episode_and_factor_only() -> None:
    first = drawn()
    assert drawn(episode=2) != first
    assert drawn() == first
    assert drawn(seed=2).light != first.light
    for factor in ("light", "materials", "camera", "clutter"):
        alone = drawn(Appearance.model_validate({factor: getattr(FULL, factor)}))
        assert getattr(alone, factor) == getattr(first, factor)
        others = {"light", "materials", "camera", "clutter"} - {factor}
        assert not any(getattr(alone, other) for other in others)


@pytest.mark.parametrize("seed", range(3))
def test_objects_keep_the_names_of_their_colours(seed: int) -> None:
    surfaces = SceneSurfaces.of(lit_room())
    names = surfaces.names()
    words = {names[target.instance_id] for target in lit_room().info.targets}
    assert words == {"red", "blue", "green"}
    repainted = set()
    for episode in range(20):
        changes = drawn(Appearance(materials=MaterialRanges()), seed, episode).materials
        changed = apply_appearance(lit_room(), None, drawn(Appearance(materials=MaterialRanges()), seed, episode))
        assert SceneSurfaces.of(changed).names() == names
        repainted |= {change.to_colour for change in changes if change.surface == "object"}
    assert len(repainted) > 5


def test_walls_and_floors_change_and_lamps_do_not() -> None:
    room = lit_room()
    changed = apply_appearance(room, None, drawn(Appearance(materials=MaterialRanges())))
    assert (changed.part_texture[:5] >= len(room.textures)).all()
    assert np.array_equal(changed.colours[-3 * 36 :], room.colours[-3 * 36 :])
    for name in ("positions", "part_first", "part_count", "part_instance", "light_uvs", "light_map"):
        assert getattr(changed, name) is getattr(room, name)


def test_empty_sets_of_materials_change_no_surface() -> None:
    nothing = MaterialRanges(walls=(), floors=(), ceilings=False, furniture=False)
    assert drawn(Appearance(materials=nothing)).materials == ()


def test_clutter_keeps_its_distance_from_the_driven_footprint_and_does_not_block_the_view_of_the_target() -> None:
    ranges, poses = ClutterRanges(count=(8, 8), clearance_m=0.2), drive()
    discs = np.stack([(poses[:, 0] + along, poses[:, 1]) for along in DISC_OFFSETS_M], axis=1).reshape(2, -1).T
    placed = 0
    for episode in range(6):
        for thing in drawn(Appearance(clutter=ranges), 1, episode).clutter:
            radius = RADII[thing.kind] * thing.size_m
            gaps = np.hypot(discs[:, 0] - thing.x_m, discs[:, 1] - thing.y_m)
            assert gaps.min() >= 0.29 + 0.2 + radius
            bearing = math.atan2(thing.y_m - poses[-1, 1], thing.x_m - poses[-1, 0])
            distance = math.hypot(thing.x_m - poses[-1, 0], thing.y_m - poses[-1, 1])
            to_target = math.atan2(target().centroid_m[1] - 0.6, target().centroid_m[0] - 1.2)
            if distance < 1.2:
                assert abs(bearing - to_target) > math.asin(min(1.0, radius / distance))
            placed += 1
    assert placed > 20


def test_clutter_stands_on_the_floor_and_has_separate_ids() -> None:
    room, factors = lit_room(), drawn(Appearance(clutter=ClutterRanges(count=(3, 3))))
    changed = apply_appearance(room, None, factors)
    assert len(changed.info.instances) == len(room.info.instances) + len(factors.clutter)
    added = changed.positions[len(room.positions) :]
    assert 0.0 < added[:, 2].min() < 0.005
    assert changed.part_instance[: len(room.part_instance)].tolist() == room.part_instance.tolist()
    things = changed.info.instances[len(room.info.instances) :]
    assert things == clutter_instances([item.id for item in room.info.instances], factors.clutter)


def test_light_of_another_scene_is_refused() -> None:
    with pytest.raises(WorldError, match="no light groups"):
        apply_appearance(lit_room(), None, drawn(Appearance(light=LightRanges())))


def test_a_camera_change_moves_the_camera_and_scales_its_focal_length() -> None:
    camera = recorded_camera(CameraConfig(), 64)
    changed = changed_camera(camera, CameraChange(x_m=0.01, pitch_deg=2.0, focal=0.93))
    assert changed.mount.x_m == pytest.approx(camera.mount.x_m + 0.01)
    assert changed.mount.pitch_deg == 2.0
    assert isinstance(changed, PinholeCamera)
    assert changed.focal_px[0] == pytest.approx(0.93 * camera.focal_px[0])
    assert changed_camera(camera, None) is camera
    low = camera.model_copy(update={"mount": camera.mount.model_copy(update={"z_m": 0.03})})
    assert changed_camera(low, CameraChange(z_m=-0.1)).mount.z_m == 0.02


def test_the_angles_of_a_changed_camera_wrap_at_180_degrees() -> None:
    back = recorded_camera(CameraConfig(), 64).model_copy(update={"mount": Mount(yaw_deg=180.0, roll_deg=-179.5)})
    mount = changed_camera(back, CameraChange(yaw_deg=1.5, roll_deg=-1.0)).mount
    assert (mount.yaw_deg, mount.roll_deg) == (-178.5, 179.5)


def test_a_focal_length_that_the_lens_does_not_permit_is_refused() -> None:
    wide = PinholeCamera(name="wide", model="pinhole", width=640, height=640, fov_deg=165)
    with pytest.raises(UsageError, match=r"smaller range camera\.focal"):
        changed_camera(wide, CameraChange(focal=0.5))
