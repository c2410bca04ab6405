"""Models and their files as Gazebo finds them: built-in models, Fuel, model.config, textures and material scripts."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from factory.scenes.build import import_scene
from factory.scenes.formats import extract_scene
from factory.scenes.formats.library import fuel_name
from factory.scenes.limits import StageLimits
from schemas.scene import decode_scene
from tests.builders.formats import ROOM, sdf_room

FUEL = "https://fuel.gazebosim.org/1.0/OpenRobotics/models/"
BOX = "<visual name='v'><geometry><box><size>1 1 1</size></box></geometry></visual>"


def write(path: Path, content: str) -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(content)
    return path


def include(*uris: str) -> str:
    return "".join(f"<include><uri>{uri}</uri></include>" for uri in uris)


def model(name: str, content: str = BOX) -> str:
    return f"<sdf version='1.6'><model name='{name}'><link name='l'>{content}</link></model></sdf>"


def table(at: str = "1 1 0.4") -> str:
    shape = "<geometry><box><size>1.2 0.8 0.8</size></box></geometry>"
    return f"<model name='table'><pose>{at} 0 0 0</pose><link name='l'><visual name='v'>{shape}</visual></link></model>"


@pytest.mark.parametrize(
    ("sun", "ground"),
    [
        ("model://sun", "model://ground_plane"),
        (f"{FUEL}Sun", f"{FUEL}Ground Plane"),
        (f"{FUEL}sun/2", f"{FUEL}Ground%20Plane/tip"),
        ("https://fuel.ignitionrobotics.org/1.0/OpenRobotics/models/Sun", "fuel://OpenRobotics/models/Ground Plane"),
    ],
)
def test_sun_and_ground_plane_of_gazebo_need_no_file(tmp_path: Path, sun: str, ground: str) -> None:
    text = f"<sdf version='1.8'><world name='w'>{include(sun, ground, ground)}{table()}</world></sdf>"
    path = write(tmp_path / "room.world", text)
    with import_scene(path, "room", tmp_path / "cache").open("rb") as file:
        info = decode_scene(file).info
    assert [target.category for target in info.targets] == ["table"]
    assert info.floor_height_m == 0.0
    assert "1 lights of the file are not used; emissive materials light the scene" in info.notes
    (note,) = [note for note in info.notes if "taken as a plane" in note]
    assert note.startswith(f"/World/ground_plane: {ground} is not in a searched folder")


def test_a_ground_plane_at_the_height_of_a_floor_is_slightly_below_it(tmp_path: Path) -> None:
    extraction = extract_scene(write(tmp_path / "w.world", sdf_room(include("model://ground_plane"))))
    (ground,) = [part for part in extraction.parts if "ground_plane" in part.path]
    assert np.allclose(ground.triangles[..., 2], -0.004)
    assert len(extraction.parts) == 2 * len(ROOM) + 1


@pytest.mark.parametrize(
    "place",
    [
        "models/Blue Box",
        "models/blue_box",
        "more/fuel.gazebosim.org/openrobotics/models/blue box/2",
        "more/openrobotics/models/blue box/2",
    ],
)
def test_a_local_copy_of_a_model_of_fuel_is_found(tmp_path: Path, place: str) -> None:
    write(tmp_path / place / "model.sdf", model("blue"))
    path = write(tmp_path / "w.world", sdf_room(include(f"{FUEL}Blue Box")))
    extraction = extract_scene(path, StageLimits(models=(tmp_path / "more",)))
    assert any("/blue/" in part.path for part in extraction.parts)


def test_a_copy_of_a_built_in_model_in_a_searched_folder_has_precedence(tmp_path: Path) -> None:
    write(tmp_path / "models" / "ground_plane" / "model.sdf", model("mine"))
    write(tmp_path / "models" / "sun" / "model.sdf", "<sdf version='1.6'><light name='s' type='directional'/></sdf>")
    path = write(tmp_path / "w.world", sdf_room(include("model://sun", "model://ground_plane")))
    extraction = extract_scene(path)
    assert any("/mine/" in part.path for part in extraction.parts)
    assert "2 lights of the file are not used; emissive materials light the scene" in extraction.notes


@pytest.mark.parametrize(
    ("uri", "parts"),
    [
        (f"{FUEL}Sun", ("OpenRobotics", "Sun", "", "")),
        (f"{FUEL}A%20B/3/files/meshes/a.dae", ("OpenRobotics", "A B", "3", "meshes/a.dae")),
        (f"{FUEL}A/tip/files/a.dae", ("OpenRobotics", "A", "", "a.dae")),
        ("model://sun", ("", "sun", "", "")),
    ],
)
def test_the_name_of_a_model_of_fuel_is_read_from_its_uri(uri: str, parts: tuple[str, ...]) -> None:
    assert fuel_name(uri) == parts
