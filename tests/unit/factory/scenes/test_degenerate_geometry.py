"""Degenerate geometry: faces without area, coordinates that are not finite."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from factory.scenes.build import import_scene
from factory.scenes.formats import extract_scene
from factory.scenes.limits import StageLimits
from schemas.errors import InvalidBundle
from schemas.scene import decode_scene
from schemas.scene.compiled import require_valid
from tests.builders.formats import picture
from tests.builders.scene import box_room

DEGENERATE = {
    "a vertical line": ("v 2 2 0\nv 2 2 0.2\nv 2 2 0.5\nv 2 2 1\n", "f 13 14 15\nf 13 15 16\nf 13 16 14\n"),
    "almost a vertical line": ("v 2 2 0\nv 2.0000001 2 0.25\nv 2 2 0.5\n", "f 13 14 15\n"),
    "a point": ("v 2 2 0\nv 2 2 0\nv 2 2 0\n", "f 13 14 15\nf 13 13 13\n"),
    "a tiny triangle": ("v 2 2 0\nv 2.000001 2 0\nv 2 2.000001 0\n", "f 13 14 15\n"),
}


@pytest.mark.parametrize("is_alone", [True, False])
@pytest.mark.parametrize("shape", DEGENERATE)
def test_faces_without_area_give_a_sound_package(tmp_path: Path, shape: str, is_alone: bool) -> None:
    vertices, faces = DEGENERATE[shape]
    box = "".join(f"v {x} {y} {z}\n" for z in (0.7, 0) for x, y in ((-0.5, -0.5), (0.5, -0.5), (0.5, 0.5), (-0.5, 0.5)))
    table = f"o Table\n{box}f 5 6 7 8\nf 9 10 6 5\nf 10 11 7 6\nf 11 12 8 7\nf 12 9 5 8\n"
    name = "o Sliver\n" if is_alone else ""
    path = tmp_path / "room.obj"
    path.write_text(f"o Floor\nv -3 -3 0\nv 3 -3 0\nv 3 3 0\nv -3 3 0\nf 1 2 3 4\n{table}{name}{vertices}{faces}")
    with import_scene(path, "room", tmp_path / "cache", limits=StageLimits(unit="m", up="z")).open("rb") as file:
        scene = decode_scene(file)
    assert [target.category for target in scene.info.targets] == ["table"]
    is_dropped = any("Sliver: ignored, its" in note and "have no area" in note for note in scene.info.notes)
    assert is_dropped is (is_alone and shape != "a tiny triangle")


def test_texture_coordinates_that_are_not_finite_are_noted(tmp_path: Path) -> None:
    picture(tmp_path)
    (tmp_path / "a.mtl").write_text("newmtl p\nmap_Kd tiles.png\n")
    path = tmp_path / "room.obj"
    path.write_text("mtllib a.mtl\nv -3 -3 0\nv 3 -3 0\nv 3 3 0\nvt nan 0\nvt inf 1\nvt 0 1\nusemtl p\nf 1/1 2/2 3/3\n")
    extraction = extract_scene(path, StageLimits(unit="m", up="z"))
    assert extraction.notes == ("/World/object: texture coordinates that are not finite are taken as 0",)
    assert extraction.parts[0].uvs is not None
    assert np.isfinite(extraction.parts[0].uvs).all()


def test_a_scene_that_no_reader_accepts_is_refused_before_it_is_written() -> None:
    scene = box_room()
    require_valid(scene)
    positions = scene.positions.copy()
    positions[0] = np.nan
    with pytest.raises(InvalidBundle, match="scene refused"):
        require_valid(replace(scene, positions=positions))
