"""The floor of a scene is the connected floor that reaches most objects."""

from __future__ import annotations

import pickle
from pathlib import Path

import pytest

from factory.scenes.build import import_scene
from factory.scenes.compile.listing import UnreachableTargets
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
