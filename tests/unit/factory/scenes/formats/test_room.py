"""One room in every format has the same content, and docs/scenes/formats.md states what each format keeps."""

from __future__ import annotations

import re
from pathlib import Path

import click
import numpy as np
import pytest

from factory.cli.scene import import_
from factory.scenes.compile.compiler import compile_stage
from factory.scenes.formats import extract_scene
from factory.scenes.importer import Extraction
from factory.scenes.limits import StageLimits
from factory.scenes.rules import builtin_rules
from factory.scenes.targets.candidates import find_candidates
from tests.builders.formats import CHAIR, ROOM, write_room
from tests.builders.pages import ROOT

SUFFIXES = (".glb", ".gltf", ".obj", ".stl", ".ply", ".dae", ".sdf", ".urdf", ".xml")
SILENT = (".obj", ".stl", ".ply")
"""Formats that do not state unit and up axis."""
FEATURES = ("names", "colours", "textures", "labels", "lights", "collision")
KEPT = {
    ".glb": "names colours textures labels collision",
    ".gltf": "names colours textures labels collision",
    ".obj": "names colours textures",
    ".stl": "names",
    ".ply": "colours",
    ".dae": "names colours",
    ".sdf": "names colours collision",
    ".urdf": "names colours collision",
    ".xml": "names colours textures collision",
}
"""Features of the room of `write_room` that each format keeps. Textures of PLY, COLLADA, SDF and URDF are tested in
test_details.py."""


def extract(path: Path) -> Extraction:
    return extract_scene(path, StageLimits(unit="m", up="z") if path.suffix in SILENT else StageLimits())


def kept(extraction: Extraction) -> set[str]:
    """Returns the features of the room that an extraction contains."""
    parts = extraction.parts
    names = {segment.lower() for part in parts for segment in part.path.split("/")}
    reds = [part.tints[..., 0].max() if part.tints is not None else part.surface.colour[0] for part in parts]
    found = {
        "names": CHAIR.name.lower() in names,
        "colours": max(reds) > 0.5,
        "textures": any(part.surface.texture and part.uvs is not None for part in parts),
        "labels": "chair" in extraction.labels.values(),
        "lights": False,
        "collision": any(part.is_collider for part in parts),
    }
    return {feature for feature, is_kept in found.items() if is_kept}


@pytest.mark.parametrize("suffix", SUFFIXES)
def test_the_room_has_the_same_shape_in_every_format_and_the_features_that_its_format_keeps(
    tmp_path: Path, suffix: str
) -> None:
    if suffix == ".xml":
        pytest.importorskip("mujoco")
    extraction = extract(write_room(tmp_path, suffix))
    assert kept(extraction) == set(KEPT[suffix].split()), extraction.notes
    shown = np.concatenate([part.triangles for part in extraction.parts if not part.is_collider])
    low, high = shown.min(axis=(0, 1)), shown.max(axis=(0, 1))
    assert np.allclose(low, ROOM[0].low, atol=1e-5)
    assert np.allclose(high, (4.2, 3.2, 2.5), atol=1e-5)
    if suffix == ".ply":  # one mesh of boxes that share edges bounds no volume, so it is shown from both sides
        return
    a, b, c = np.moveaxis(shown, 1, 0)
    volume = sum(np.prod(np.subtract(box.high, box.low)) for box in ROOM)
    assert np.einsum("ij,ij->", a, np.cross(b, c)) / 6 == pytest.approx(volume, rel=1e-3)  # wound outwards


@pytest.mark.parametrize("suffix", [suffix for suffix in SUFFIXES if "names" in KEPT[suffix]])
def test_the_chair_is_a_candidate_in_every_format_with_names(tmp_path: Path, suffix: str) -> None:
    if suffix == ".xml":
        pytest.importorskip("mujoco")
    extraction = extract(write_room(tmp_path, suffix))
    shown = [part for part in extraction.parts if not part.is_collider]
    found = find_candidates(extraction, shown, builtin_rules(), lambda _parts: "red")
    assert [candidate.category for candidate in found] == ["chair"]


def test_a_room_of_gltf_compiles_to_a_package_with_a_red_chair(tmp_path: Path) -> None:
    scene = compile_stage(write_room(tmp_path, ".glb"), "room", "room.glb")
    (target,) = scene.info.targets
    assert (target.category, target.colour) == ("chair", "red")
    assert scene.textures[0][0, 0].tolist() == [40, 90, 200]
    assert scene.light_map.size  # the light is estimated, without the lamp of the file
    assert any("1 lights of the file are not used" in note for note in scene.info.notes)


def test_the_page_states_what_each_format_keeps() -> None:
    rows = re.findall(r"^\| ([^|]*) \| (\S+) \|(.*)\|$", (ROOT / "docs" / "scenes" / "formats.md").read_text(), re.M)
    table = {suffix: [cell.strip() for cell in cells.split("|")] for _, suffix, cells in rows if suffix.startswith(".")}
    for suffix, features in KEPT.items():
        stated = dict(zip(FEATURES, table[suffix], strict=True))
        for feature in features.split():
            assert stated[feature] != "no", (suffix, feature)
        assert stated["lights"] == "no"


def test_shell_completion_offers_scene_files_and_names_their_formats(tmp_path: Path) -> None:
    (tmp_path / "notes.txt").write_text("")
    write_room(tmp_path, ".stl")
    (argument,) = [one for one in import_.params if one.name == "file"]
    items = argument.shell_complete(click.Context(import_), f"{tmp_path}/")
    assert [(item.value, item.help) for item in items if item.type == "plain"] == [(f"{tmp_path}/room.stl", "STL")]
