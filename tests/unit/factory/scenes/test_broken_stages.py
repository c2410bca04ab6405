"""A corpus of small broken stages: each is read, keeps its valid box, and names the broken prim."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from factory.scenes.compile.compiler import compile_stage
from factory.scenes.compile.textures import load_textures
from factory.scenes.importer import Extraction
from factory.scenes.importer.assets import read_asset
from factory.scenes.importer.extract import extract_stage
from tests.builders.stage import StageText, room_body

TEXT = StageText()
GOOD = TEXT.box("Good", (0, 0, 0), (1, 2, 3))


def mesh(name: str, points: str, counts: str = "[3]", indices: str = "[0, 1, 2]", more: str = "") -> str:
    return f"""
    def Mesh "{name}" {{
        point3f[] points = {points}
        int[] faceVertexCounts = {counts}
        int[] faceVertexIndices = {indices}
        uniform token subdivisionScheme = "none"
        {more}
    }}
"""


def textured(asset: str) -> str:
    """A triangle with a textured colour."""
    return (
        mesh(
            "Bad",
            CORNERS,
            more="""
        texCoord2f[] primvars:st = [(0, 0), (1, 0), (0, 1)] (interpolation = "vertex")
        rel material:binding = </World/Paint>""",
        )
        + f"""
    def Material "Paint" {{
        token outputs:surface.connect = </World/Paint/Shader.outputs:surface>
        def Shader "Shader" {{
            uniform token info:id = "UsdPreviewSurface"
            color3f inputs:diffuseColor.connect = </World/Paint/Picture.outputs:rgb>
            token outputs:surface
        }}
        def Shader "Picture" {{
            uniform token info:id = "UsdUVTexture"
            asset inputs:file = @{asset}@
            float3 outputs:rgb
        }}
    }}
"""
    )


CORNERS = "[(0, 0, 0), (1, 0, 0), (0, 1, 0)]"
QUAD = "[(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0)]"
SUBSET = """
    def GeomSubset "{name}" {{
        uniform token elementType = "face"
        uniform token familyName = "materialBind"
        int[] indices = {faces}
    }}
"""
BOUND = mesh("Bad", CORNERS, more="rel material:binding = </World/Paint>")


@dataclass(frozen=True)
class Case:
    """A broken stage, the expected note, and the number of triangles of its broken prims."""

    body: str
    words: tuple[str, ...]
    triangles: int


CASES = {
    "not a number": Case(mesh("Bad", "[(0, 0, 0), (nan, 0, 0), (0, 1, 0)]"), ("/World/Bad", "not finite"), 0),
    "infinite": Case(mesh("Bad", "[(0, 0, 0), (inf, 0, 0), (0, 1, 0)]"), ("/World/Bad", "not finite"), 0),
    "index past the points": Case(
        mesh("Bad", CORNERS, indices="[0, 1, 7]"),
        ("/World/Bad", "vertices 0 to 7 (from 0) are used, but there are 3"),
        0,
    ),
    "negative index": Case(
        mesh("Bad", CORNERS, indices="[0, 1, -1]"),
        ("/World/Bad", "vertices -1 to 1 (from 0) are used, but there are 3"),
        0,
    ),
    "negative count": Case(
        mesh("Bad", CORNERS, "[-3, 6]", "[0, 1, 2]"), ("/World/Bad", "bad topology: the faces need 3"), 0
    ),
    "huge count": Case(mesh("Bad", CORNERS, "[2147483647]"), ("/World/Bad", "the faces need 2147483647 corners"), 0),
    "no faces": Case(mesh("Bad", CORNERS, "[]", "[]"), ("/World/Bad", "without points or faces"), 0),
    "degenerate faces": Case(mesh("Bad", CORNERS, "[1, 2, 3, 3]", "[0, 0, 1, 1, 1, 1, 0, 1, 2]"), (), 2),
    "concave face on a line": Case(
        mesh("Bad", "[(0, 0, 0), (2, 0, 0), (1, 0, 0), (3, 0, 0)]", "[4]", "[0, 1, 2, 3]"), (), 2
    ),
    "subdivision cage": Case(
        mesh("Bad", QUAD, "[4]", "[0, 1, 2, 3]").replace('"none"', '"catmullClark"'), ("/World/Bad", "control cage"), 2
    ),
    "zero scale": Case(
        mesh(
            "Bad", CORNERS, more='double3 xformOp:scale = (0, 0, 0)\nuniform token[] xformOpOrder = ["xformOp:scale"]'
        ),
        (),
        1,
    ),
    "infinite place": Case(
        mesh(
            "Bad",
            CORNERS,
            more='double3 xformOp:translate = (inf, 0, 0)\nuniform token[] xformOpOrder = ["xformOp:translate"]',
        ),
        ("/World/Bad", "not finite"),
        0,
    ),
    "time samples only": Case(
        mesh("Bad", CORNERS).replace("points = " + CORNERS, "points.timeSamples = { 1: " + CORNERS + " }"), (), 1
    ),
    "curves": Case(
        'def BasisCurves "Bad" {\nint[] curveVertexCounts = [4]\n'
        "point3f[] points = [(0, 0, 0), (1, 0, 0), (2, 0, 0), (3, 1, 0)]\n}\n",
        ("/World/Bad", "BasisCurves is not supported"),
        0,
    ),
    "nurbs": Case(
        'def NurbsPatch "Bad" {\nint uVertexCount = 2\nint vVertexCount = 2\npoint3f[] points = [(0, 0, 0)]\n}\n',
        ("/World/Bad", "NurbsPatch is not supported"),
        0,
    ),
    "points": Case('def Points "Bad" {\npoint3f[] points = [(0, 0, 0)]\n}\n', ("/World/Bad", "not supported"), 0),
    "reference to itself": Case('def Xform "Bad" (references = </World/Bad>) {\n}\n', ("/World/Bad", "Cycle"), 0),
    "odd names": Case(mesh("Stühle_и_столы_" + "x" * 300, CORNERS), (), 1),
    "overlapping subsets": Case(
        mesh(
            "Bad",
            QUAD,
            "[3, 3]",
            "[0, 1, 2, 0, 2, 3]",
            SUBSET.format(name="One", faces="[0, 1]") + SUBSET.format(name="Two", faces="[1, 1, 99, -5]"),
        ),
        (),
        2,
    ),
    "material of MDL alone": Case(
        BOUND
        + """
    def Material "Paint" {
        token outputs:mdl:surface.connect = </World/Paint/Shader.outputs:out>
        def Shader "Shader" {
            uniform token info:implementationSource = "sourceAsset"
            uniform asset info:mdl:sourceAsset = @OmniPBR.mdl@
            uniform token info:mdl:sourceAsset:subIdentifier = "OmniPBR"
            color3f inputs:diffuse_color_constant = (0.6, 0, 0)
            token outputs:out
        }
    }
""",
        (),
        1,
    ),
    "material without shader": Case(BOUND + 'def Material "Paint" {\n}\n', ("/World/Paint",), 1),
    "shaders in a ring": Case(
        BOUND
        + """
    def Material "Paint" {
        token outputs:surface.connect = </World/Paint/Shader.outputs:surface>
        def Shader "Shader" {
            uniform token info:id = "UsdPreviewSurface"
            color3f inputs:diffuseColor.connect = </World/Paint/One.outputs:rgb>
            token outputs:surface
        }
        def Shader "One" {
            uniform token info:id = "UsdUVTexture"
            float2 inputs:st.connect = </World/Paint/Two.outputs:result>
            float3 outputs:rgb
        }
        def Shader "Two" {
            uniform token info:id = "UsdTransform2d"
            float2 inputs:in.connect = </World/Paint/Two.outputs:result>
            float2 outputs:result
        }
    }
""",
        ("/World/Paint/One", "without a file"),
        1,
    ),
    "colour from a ring of inputs": Case(
        BOUND
        + """
    def Material "Paint" {
        color3f inputs:a.connect = </World/Paint.inputs:b>
        color3f inputs:b.connect = </World/Paint.inputs:a>
        token outputs:surface.connect = </World/Paint/Shader.outputs:surface>
        def Shader "Shader" {
            uniform token info:id = "UsdPreviewSurface"
            color3f inputs:diffuseColor.connect = </World/Paint.inputs:a>
            token outputs:surface
        }
    }
""",
        (),
        1,
    ),
}


def extract(tmp_path: Path, body: str) -> Extraction:
    return extract_stage(TEXT.write(tmp_path / "scene.usda", body))


@pytest.mark.parametrize("case", CASES.values(), ids=[name.replace(" ", "_") for name in CASES])
def test_a_broken_prim_is_named_and_does_not_affect_others(tmp_path: Path, case: Case) -> None:
    extraction = extract(tmp_path, GOOD + case.body)
    assert sum(len(part.triangles) for part in extraction.parts if part.path == "/World/Good") == 12
    assert sum(len(part.triangles) for part in extraction.parts if part.path != "/World/Good") == case.triangles
    assert all(np.isfinite(part.triangles).all() for part in extraction.parts)
    assert any(all(word in note for word in case.words) for note in (*extraction.notes, "")), extraction.notes


def test_nested_instances_are_all_extracted(tmp_path: Path) -> None:
    body = (
        'def Xform "Inner" {' + GOOD + "}\n"
        'def Xform "Outer" {\ndef Xform "A" (instanceable = true\nreferences = </World/Inner>) {}\n'
        'def Xform "B" (instanceable = true\nreferences = </World/Inner>) {}\n}\n'
        'def Xform "Copy" (instanceable = true\nreferences = </World/Outer>) {}\n'
    )
    paths = {part.path for part in extract(tmp_path, body).parts}
    assert paths == {f"/World/{p}/Good" for p in ("Inner", "Outer/A", "Outer/B", "Copy/A", "Copy/B")}


@pytest.mark.parametrize(
    ("asset", "file"),
    [
        ("broken.exr", "broken.exr"),
        ("broken.png", "broken.png"),
        ("wood.<UDIM>.png", "wood.1001.png"),
        ("stone.<UDIM>.png", ""),
        ("missing.png", ""),
        ("https://example.com/missing.png", ""),
    ],
)
def test_the_file_of_an_unreadable_texture_is_named_in_a_note(tmp_path: Path, asset: str, file: str) -> None:
    if file:
        (tmp_path / file).write_bytes(b"v/1\x01 no picture at all")
    extraction = extract(tmp_path, GOOD + textured(asset))
    paths = {part.surface.texture for part in extraction.parts} - {""}
    notes = load_textures(dict.fromkeys(paths, 1.0), read_asset).notes
    assert [note.split()[:4] for note in notes] == [
        ["texture", file or asset.rpartition("/")[2], *(("cannot", "be") if file else ("is", "missing,"))]
    ]


def test_only_the_first_udim_tile_is_used_and_the_material_is_named(tmp_path: Path) -> None:
    for tile, colour in ((1001, (200, 10, 10)), (1002, (10, 200, 10))):
        Image.new("RGB", (4, 4), colour).save(tmp_path / f"wood.{tile}.png")
    extraction = extract(tmp_path, textured("wood.<UDIM>.png"))
    (part,) = extraction.parts
    assert part.surface.texture == str(tmp_path / "wood.1001.png")
    assert any(note.startswith("/World/Paint: of 2 UDIM tiles") for note in extraction.notes)


def test_a_room_with_every_broken_prim_compiles_to_a_scene(tmp_path: Path) -> None:
    groups = [
        TEXT.group(f"Case{number}", case.body.replace("/World/", f"/World/Case{number}/"), at=(1.0, -1.0, 1.0))
        for number, case in enumerate(CASES.values())
    ]
    far = TEXT.group("Far", TEXT.box("Box", (0, 0, 0), (1, 1, 1)), at=(1e30, 0.0, 0.0))
    scene = compile_stage(TEXT.write(tmp_path / "room.usda", room_body(TEXT, "".join(groups) + far)), "room", "test")
    assert [target.category for target in scene.info.targets] == ["chair"]
    assert any(note.startswith("/World/Far/Box: omitted") for note in scene.info.notes)
    assert max(abs(value) for corner in scene.info.bounds_m for value in corner) < 10
