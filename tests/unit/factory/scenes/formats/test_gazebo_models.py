"""Models and their files as Gazebo finds them: built-in models, Fuel, model.config, textures and material scripts."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from factory.scenes.build import import_scene
from factory.scenes.formats import extract_scene
from factory.scenes.formats.library import fuel_name
from factory.scenes.formats.ogre import read_materials
from factory.scenes.limits import StageLimits
from schemas.scene import decode_scene
from tests.builders.formats import ROOM, picture, sdf_room, stl_room

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


PLAIN = "material Crate/Plain { technique { pass { ambient 0.5 0.5 0.5 1\n diffuse 1 0 0 0.8\n emissive 0 0 1 1 } } }"
PRINTED = """// a comment with a brace {
material Crate/Printed : Crate/Plain
{
  technique
  {
    pass { alpha_rejection greater 128
      texture_unit
      {
        texture "label.png"
        scale 2 2
      }
      texture_unit { texture gloss.png }
    }
    pass { diffuse 0 1 0 }
  }
  technique { pass { diffuse 0 0 1 } }
} /* end } */
"""


def scripted(name: str, uris: str = "") -> str:
    look = f"<material><script>{uris}<name>{name}</name></script></material>"
    return BOX.replace("</visual>", f"{look}</visual>")


def test_materials_of_ogre_have_the_first_pass_inherit_and_keep_texture_scale_and_holes() -> None:
    materials = read_materials(f"{PLAIN}\n{PRINTED}")
    plain, printed = materials["Crate/Plain"], materials["Crate/Printed"]
    assert plain.surface().colour == pytest.approx((1.0, 0.0, 0.0))
    assert (plain.opacity, plain.emissive, plain.texture) == (0.8, pytest.approx((0.0, 0.0, 1.0)), "")
    assert printed.diffuse == plain.diffuse
    assert (printed.texture, printed.scale, printed.cut_below) == ("label.png", (2.0, 2.0), 128 / 255)


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("material A { technique { pass { diffuse x 0 0 } } }", "line 1: 'diffuse x 0 0' is not valid"),
        ("material A\n{\ntechnique {\n", "'technique' is not closed"),
        ("}", "line 1: a block is closed that was not opened"),
        ("material A {" * 30, "nested more than 20 deep"),
        ("material A { technique { pass { texture_unit {\nscale 0 1 } } } }", "line 2: 'scale 0 1' is not valid"),
    ],
)
def test_a_script_that_is_not_valid_is_refused_with_its_line(text: str, reason: str) -> None:
    with pytest.raises(ValueError, match=reason):
        read_materials(text)


@pytest.mark.parametrize(
    "uris", ["", "<uri>model://crate/materials/scripts</uri>", "<uri>materials/scripts/a.material</uri>"]
)
def test_a_material_script_gives_colour_and_a_texture_of_the_textures_folder(tmp_path: Path, uris: str) -> None:
    crate = tmp_path / "models" / "crate"
    write(crate / "model.sdf", model("crate", scripted("Crate/Printed", uris)))
    write(crate / "materials" / "scripts" / "a.material", PLAIN + PRINTED)
    picture(crate / "materials" / "textures", "label.png")
    extraction = extract_scene(write(tmp_path / "w.world", sdf_room(include("model://crate"))))
    (part,) = [part for part in extraction.parts if "/crate/" in part.path]
    assert part.surface.texture == str(crate / "materials" / "textures" / "label.png")
    assert part.surface.colour == pytest.approx((1.0, 0.0, 0.0))
    assert part.surface.cutout is not None
    assert part.uvs is not None
    for number in range(0, 12, 2):  # each side shows the middle half of the texture
        side = part.uvs[number : number + 2]
        assert np.allclose(side.min(axis=(0, 1)), 0.25)
        assert np.allclose(side.max(axis=(0, 1)), 0.75)


def test_a_faulty_script_and_an_unknown_material_are_named_with_their_files(tmp_path: Path) -> None:
    crate = tmp_path / "models" / "crate"
    write(crate / "model.sdf", model("crate", scripted("Crate/Lost") + scripted("Gazebo/Red")))
    write(crate / "materials" / "scripts" / "a.material", "material A {")
    extraction = extract_scene(write(tmp_path / "w.world", sdf_room(include("model://crate"))))
    assert any(note.startswith("models/crate/materials/scripts/a.material: the block") for note in extraction.notes)
    (lost,) = [note for note in extraction.notes if "Crate/Lost" in note]
    assert "Crate/Lost of models/crate/model.sdf is defined neither in materials/scripts nor by Gazebo" in lost


def test_the_texture_of_a_mesh_is_searched_in_the_textures_folder_of_its_model(tmp_path: Path) -> None:
    crate = tmp_path / "models" / "crate"
    mesh = "<visual name='v'><geometry><mesh><uri>model://crate/meshes/c.obj</uri></mesh></geometry></visual>"
    write(crate / "model.sdf", model("crate", mesh))
    write(crate / "meshes" / "c.mtl", "newmtl m\nmap_Kd label.png")
    write(
        crate / "meshes" / "c.obj",
        "mtllib c.mtl\nusemtl m\nv 0 0 0\nv 1 0 0\nv 0 1 0\nvt 0 0\nvt 1 0\nvt 0 1\nf 1/1 2/2 3/3",
    )
    picture(crate / "materials" / "textures", "label.png")
    extraction = extract_scene(write(tmp_path / "w.world", sdf_room(include("model://crate"))))
    (part,) = [part for part in extraction.parts if "/crate/" in part.path]
    assert part.surface.texture == str(crate / "materials" / "textures" / "label.png")


@pytest.mark.parametrize("place", ["blue_box", "blue box/3"])
def test_a_model_that_names_itself_is_imported_from_its_own_folder(tmp_path: Path, place: str) -> None:
    folder = tmp_path / place
    uri = "<uri>model://Blue%20Box/meshes/c.stl</uri>"
    mesh = f"<visual name='v'><geometry><mesh>{uri}</mesh></geometry></visual>"
    write(folder / "model.config", "<model><name>Blue Box</name><sdf version='1.6'>model.sdf</sdf></model>")
    path = write(folder / "model.sdf", model("blue", mesh))
    write(folder / "meshes" / "c.stl", stl_room())
    assert len(extract_scene(path).parts) == len(ROOM)
