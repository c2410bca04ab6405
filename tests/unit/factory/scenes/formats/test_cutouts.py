"""Textures that cut holes: masks of glTF and USD reach the package with their thresholds and channels."""

from __future__ import annotations

import io
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from factory.scenes.build import import_scene
from factory.scenes.compile.compiler import compile_stage
from factory.scenes.formats import extract_scene
from factory.scenes.limits import StageLimits
from schemas.scene import DRAWN, CompiledScene, decode_scene
from tests.builders.formats import gltf_room
from tests.builders.stage import StageText, room_body

SIDE = 64
LEAF = (30, 140, 40)


def leaf(folder: Path, name: str = "tiles.png") -> Path:
    """Writes a picture of a leaf with opacity 255, 100 and 0 in a quarter, a quarter and a half of its width."""
    pixels = np.zeros((SIDE, SIDE, 4), np.uint8)
    pixels[..., :3] = LEAF
    pixels[:, : SIDE // 4, 3], pixels[:, SIDE // 4 : SIDE // 2, 3] = 255, 100
    pixels[:, SIDE // 2 :, :3] = 0
    Image.fromarray(pixels).save(folder / name)
    return folder / name


def imported_gltf(folder: Path, **material: object) -> CompiledScene:
    document = gltf_room(folder)
    # the picture of the room is replaced by the leaf, which has another length
    leaf_view = document.view(leaf(folder).read_bytes())
    document.json["images"][0]["bufferView"] = leaf_view
    textured = next(each for each in document.json["materials"] if "baseColorTexture" in each["pbrMetallicRoughness"])
    textured["pbrMetallicRoughness"] |= material.pop("base", {})  # type: ignore[arg-type]
    textured |= material
    path = folder / "room.glb"
    path.write_bytes(document.glb())
    with import_scene(path, "room", folder / "cache").open("rb") as file:
        return decode_scene(file)


def drawn_share(scene: CompiledScene) -> float:
    """Returns the share of the only mask that is drawn."""
    (mask,) = scene.masks.values()
    return float((mask >= DRAWN).mean())


@pytest.mark.parametrize(
    ("material", "share"),
    [
        ({"alphaMode": "MASK"}, 0.25),
        ({"alphaMode": "MASK", "alphaCutoff": 0.3}, 0.5),
        ({"alphaMode": "MASK", "alphaCutoff": 0.3, "base": {"baseColorFactor": [1, 1, 1, 0.5]}}, 0.25),
        ({"alphaMode": "MASK", "alphaCutoff": 0.6, "base": {"baseColorFactor": [1, 1, 1, 0.5]}}, 0.0),
    ],
    ids=["default cutoff", "low cutoff", "factor", "factor below the cutoff"],
)
def test_a_mask_of_gltf_is_drawn_above_its_cutoff(tmp_path: Path, material: dict[str, object], share: float) -> None:
    scene = imported_gltf(tmp_path, **material)
    assert drawn_share(scene) == pytest.approx(share, abs=0.01)
    assert scene.part_is_cut.sum() == 1
    assert not any("alpha" in note for note in scene.info.notes)


def test_colours_of_holes_do_not_reach_the_edges(tmp_path: Path) -> None:
    scene = imported_gltf(tmp_path, alphaMode="MASK")
    (layer,) = scene.masks
    assert np.abs(scene.textures[layer].astype(int) - LEAF).max() <= 2


@pytest.mark.parametrize("mode", ["OPAQUE", "BLEND"])
def test_other_modes_have_no_holes_and_blending_is_noted(tmp_path: Path, mode: str) -> None:
    scene = imported_gltf(tmp_path, alphaMode=mode)
    assert not scene.masks
    assert scene.info.format == 3
    assert any("blended by alpha" in note for note in scene.info.notes) is (mode == "BLEND")


def test_a_mask_without_alpha_or_with_cutoff_0_is_solid(tmp_path: Path) -> None:
    document = gltf_room(tmp_path)
    for material in document.json["materials"]:
        material["alphaMode"] = "MASK"
    (tmp_path / "room.glb").write_bytes(document.glb())
    with import_scene(tmp_path / "room.glb", "room", tmp_path / "cache").open("rb") as file:
        assert not decode_scene(file).masks
    (tmp_path / "other").mkdir()
    assert not imported_gltf(tmp_path / "other", alphaMode="MASK", alphaCutoff=0).masks


def card(text: StageText, opacity: str, base: bool = True, threshold: str = "0.5") -> str:
    """Returns a textured card beside the chair, and its material; `opacity` is the connected output of a texture."""
    colour = "color3f inputs:diffuseColor.connect = </World/Leaf/Picture.outputs:rgb>"
    plain = "color3f inputs:diffuseColor = (0.1, 0.6, 0.1)"
    return f"""
    def Mesh "Card" (prepend apiSchemas = ["MaterialBindingAPI"]) {{
        point3f[] points = [{text.vector((-2, 1, 0))}, {text.vector((-1, 1, 0))},
                            {text.vector((-1, 1, 1))}, {text.vector((-2, 1, 1))}]
        int[] faceVertexCounts = [4]
        int[] faceVertexIndices = [0, 1, 2, 3]
        bool doubleSided = 1
        texCoord2f[] primvars:st = [(0, 0), (1, 0), (1, 1), (0, 1)] (interpolation = "vertex")
        rel material:binding = </World/Leaf>
    }}
    def Material "Leaf" {{
        token outputs:surface.connect = </World/Leaf/Surface.outputs:surface>
        def Shader "Surface" {{
            uniform token info:id = "UsdPreviewSurface"
            {colour if base else plain}
            float inputs:opacity.connect = </World/Leaf/Picture.outputs:{opacity}>
            float inputs:opacityThreshold = {threshold}
            token outputs:surface
        }}
        def Shader "Picture" {{
            uniform token info:id = "UsdUVTexture"
            asset inputs:file = @leaf.png@
            float3 outputs:rgb
            float outputs:a
            float outputs:r
            float outputs:g
        }}
    }}
"""


@pytest.mark.parametrize(
    ("opacity", "base", "threshold", "share"),
    [
        ("a", True, "0.5", 0.25),
        ("a", True, "0.3", 0.5),
        ("g", True, "0.5", 0.5),
        ("a", False, "0.5", 0.25),
        ("r", True, "0.5", 0.0),
    ],
    ids=["alpha", "low threshold", "green", "colour without texture", "red"],
)
def test_an_opacity_threshold_of_usd_cuts_holes(
    tmp_path: Path, opacity: str, base: bool, threshold: str, share: float
) -> None:
    leaf(tmp_path, "leaf.png")
    text = StageText()
    path = text.write(tmp_path / "room.usda", room_body(text, card(text, opacity, base, threshold)))
    scene = compile_stage(path, "room", "test")
    assert drawn_share(scene) == pytest.approx(share, abs=0.01)
    if not base:
        (layer,) = scene.masks
        assert (scene.textures[layer] == 255).all()


def test_an_opacity_texture_without_threshold_has_no_holes(tmp_path: Path) -> None:
    leaf(tmp_path, "leaf.png")
    text = StageText()
    path = text.write(tmp_path / "room.usda", room_body(text, card(text, "a", threshold="0")))
    assert not compile_stage(path, "room", "test").masks


def test_the_digest_covers_the_opacity_texture_and_outside_files_are_refused(tmp_path: Path) -> None:
    leaf(tmp_path, "leaf.png")
    text = StageText()
    body = card(text, "a").replace("@leaf.png@", "@../secret.png@")
    first = extract_scene(text.write(tmp_path / "a.usda", room_body(text, card(text, "a", base=False))))
    Image.new("RGBA", (4, 4), (1, 2, 3, 4)).save(tmp_path / "leaf.png")
    second = extract_scene(tmp_path / "a.usda")
    assert first.sha256 != second.sha256
    (tmp_path / "sub").mkdir()
    leaf(tmp_path, "secret.png")
    outside = extract_scene(text.write(tmp_path / "sub" / "b.usda", room_body(text, body)))
    assert all(part.surface.cutout is None for part in outside.parts)
    assert any("outside of the stage's folder" in note for note in outside.notes)


def test_a_missing_opacity_texture_is_named(tmp_path: Path) -> None:
    text = StageText()
    path = text.write(tmp_path / "room.usda", room_body(text, card(text, "a")))
    scene = compile_stage(path, "room", "test", limits=StageLimits())
    assert not scene.masks
    assert any("leaf.png is missing" in note for note in scene.info.notes)


def test_equal_inputs_give_equal_packages(tmp_path: Path) -> None:
    packages = []
    for name in ("one", "two"):
        (tmp_path / name).mkdir()
        imported_gltf(tmp_path / name, alphaMode="MASK")
        (package,) = (tmp_path / name / "cache").glob("*.scene.zip")
        packages.append(package.read_bytes())
    assert packages[0] == packages[1]
    assert decode_scene(io.BytesIO(packages[0])).info.format == 5
