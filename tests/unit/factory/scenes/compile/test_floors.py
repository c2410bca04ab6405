"""The floor of a scene is the connected floor that reaches most objects."""

from __future__ import annotations

import pickle
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from factory.scenes.build import import_scene
from factory.scenes.compile.compiler import compile_stage
from factory.scenes.compile.listing import UnreachableTargets
from factory.scenes.importer import solids
from factory.scenes.importer.polygons import triangulate
from factory.scenes.limits import USUAL_LIMITS
from factory.scenes.navigation.floor import find_floor_height
from schemas.errors import WorldError
from schemas.scene import SceneInfo, decode_scene

INSIDE = {"table": "1 1 0.4 1.2 0.8 0.8", "cabinet": "-3 -2 0.5 0.5 0.5 1"}


def box(name: str, numbers: str) -> str:
    x, y, z, *size = numbers.split()
    shape = f"<geometry><box><size>{' '.join(size)}</size></box></geometry>"
    link = f"<link name='l'><visual name='v'>{shape}</visual></link>"
    return f"<model name='{name}'><pose>{x} {y} {z} 0 0 0</pose>{link}</model>"


def house(folder: Path, boxes: dict[str, str]) -> Path:
    """Writes a closed house of 10 x 10 m on a ground plane of 100 x 100 m."""
    plane = "<geometry><plane><normal>0 0 1</normal><size>100 100</size></plane></geometry>"
    ground = f"<model name='ground'><link name='l'><visual name='v'>{plane}</visual></link></model>"
    walls = {
        "north": "0 5 1.25 10 0.2 2.5",
        "south": "0 -5 1.25 10 0.2 2.5",
        "east": "5 0 1.25 0.2 10 2.5",
        "west": "-5 0 1.25 0.2 10 2.5",
    }
    models = "".join(box(name, numbers) for name, numbers in (walls | boxes).items())
    path = folder / "house.world"
    path.write_text(f"<sdf version='1.6'><world name='w'>{ground}{models}</world></sdf>")
    return path


def info_of(package: Path) -> SceneInfo:
    with package.open("rb") as file:
        return decode_scene(file).info


def test_the_inside_of_a_closed_house_is_its_floor_although_the_garden_is_larger(tmp_path: Path) -> None:
    info = info_of(import_scene(house(tmp_path, INSIDE), "house", tmp_path / "cache"))
    assert [target.category for target in info.targets] == ["cabinet", "table"]
    assert 60 < info.free_area_m2 < 100
    assert any("reaches 2 of 2 objects is used, not the largest" in note for note in info.notes)


def test_the_larger_floor_is_used_if_it_reaches_as_many_objects(tmp_path: Path) -> None:
    boxes = INSIDE | {"bench": "8 0 0.3 1 0.5 0.6", "sofa": "-8 0 0.4 0.9 2 0.8"}
    info = info_of(import_scene(house(tmp_path, boxes), "house", tmp_path / "cache"))
    assert {target.category for target in info.targets} == {"bench", "sofa"}
    assert info.free_area_m2 > 100


def test_a_map_is_written_if_no_object_is_reachable(tmp_path: Path) -> None:
    sides = {"n": "0 1 1 3 0.2 2", "s": "0 -1 1 3 0.2 2", "e": "1 0 1 0.2 3 2", "w": "-1 0 1 0.2 3 2"}
    closed = {"table": "0 0 0.4 1 1 0.8"} | sides
    path = house(tmp_path, closed)
    with pytest.raises(WorldError, match=r"no reachable target.*map of the floor and the objects: .*house\.map\.png"):
        import_scene(path, "house", tmp_path / "cache")
    assert (tmp_path / "cache" / "house.map.png").read_bytes().startswith(b"\x89PNG")


def test_the_error_of_unreachable_targets_can_be_sent_from_a_child_process() -> None:
    assert str(pickle.loads(pickle.dumps(UnreachableTargets("no target", b"map")))) == "no target"


def without_ground(folder: Path, more: str = "") -> Path:
    boxes = {"board": "1 1 0.72 2.4 1.6 0.06", "leg": "1 1 0.35 0.1 0.1 0.7", "cabinet": "-3 -2 0.5 0.5 0.5 1"}
    path = folder / "room.world"
    models = "".join(box(name, numbers) for name, numbers in boxes.items())
    path.write_text(f"<sdf version='1.6'><world name='w'>{models}{more}</world></sdf>")
    return path


def test_an_added_floor_is_slightly_below_a_floor_of_the_file_so_they_do_not_flicker(tmp_path: Path) -> None:
    path, flat = without_ground(tmp_path, box("floor", "0 0 -0.05 10 10 0.1")), USUAL_LIMITS
    plain = import_scene(path, "plain", tmp_path / "cache")
    package = import_scene(path, "both", tmp_path / "cache", limits=replace(flat, floor_m=0.0))
    with package.open("rb") as file:
        scene = decode_scene(file)
    ids = {instance.prim_path: instance.id for instance in scene.info.instances}
    (part,) = np.flatnonzero(scene.part_instance == ids["/AddedFloor"])
    corners = scene.positions[scene.part_first[part] :][: scene.part_count[part]]
    assert np.allclose(corners[:, 2], -0.004, atol=1e-6)
    assert sum(note.startswith("--floor: the file has level faces of 100 m2 at") for note in scene.info.notes) == 1
    assert [target.prim_path for target in scene.info.targets] == [
        target.prim_path for target in info_of(plain).targets
    ]


def test_a_file_without_a_ground_names_the_height_of_the_floor_to_add(tmp_path: Path) -> None:
    path = without_ground(tmp_path)
    with pytest.raises(WorldError, match=r"if the file has no ground, add one with --floor 0\b"):
        import_scene(path, "room", tmp_path / "cache")
    limits = replace(USUAL_LIMITS, floor_m=0.0)
    info = info_of(import_scene(path, "room", tmp_path / "cache", limits=limits))
    assert [target.category for target in info.targets] == ["cabinet"]
    assert not any("no ground" in note for note in info.notes)


def test_a_file_without_any_level_face_names_the_height_of_the_floor_to_add(tmp_path: Path) -> None:
    path = tmp_path / "room.world"
    path.write_text(f"<sdf version='1.6'><world name='w'>{box('cabinet', '1 0 1 0.5 0.5 1')}</world></sdf>")
    with pytest.raises(WorldError, match=r"no floor.*add a floor to a file without one: --floor 0\.5$"):
        import_scene(path, "room", tmp_path / "cache")


@pytest.mark.parametrize("height", [0.05, 0.2, 0.38])
def test_the_upper_side_of_a_slab_is_the_floor_although_the_lower_side_is_visible_from_above(height: float) -> None:
    points, counts, indices = solids.box(5.0, 4.0, height / 2)
    slab = points[indices[triangulate(points, counts, indices).corners]]
    ceiling, room = slab + np.array([0.0, 0.0, 2.5]), slab * (0.95, 0.95, 1.0)
    both = np.concatenate([slab, slab[:, ::-1], ceiling, ceiling[:, ::-1]])
    assert find_floor_height(both) == pytest.approx(height / 2, abs=1e-4)
    assert find_floor_height(np.concatenate([room, slab[:, ::-1]])) == pytest.approx(height / 2, abs=1e-4)


def test_a_stage_on_a_floor_and_a_space_in_which_the_robot_fits_keep_the_lower_floor() -> None:
    floor = solids.plane(5.0, 4.0)[0][[[0, 1, 2], [0, 2, 3]]]
    stage = floor * (0.5, 0.5, 1.0) + np.array([0.0, 0.0, 0.3])
    assert find_floor_height(np.concatenate([floor, stage])) == 0.0
    assert find_floor_height(np.concatenate([floor, floor + np.array([0.0, 0.0, 0.6])])) == 0.0


def test_a_scene_without_notes_and_without_known_objects_is_refused_with_the_ways_to_name_targets(
    tmp_path: Path,
) -> None:
    path = tmp_path / "room.world"
    path.write_text(f"<sdf version='1.6'><world name='w'>{box('thing', '0 0 -0.05 6 6 0.1')}</world></sdf>")
    with pytest.raises(UnreachableTargets, match=r"no instance of a known category.*--rules.*--targets"):
        compile_stage(path, "room", "room.world")
