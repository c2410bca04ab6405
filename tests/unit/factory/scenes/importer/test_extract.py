"""Extraction of the visible geometry of a stage, in metres and z up."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from factory.scenes.importer import Extraction, Part
from factory.scenes.importer.diagnostics import summarise
from factory.scenes.importer.extract import extract_stage
from schemas.errors import UsageError, WorldError
from tests.builders.stage import StageText, room_body

TEXT = StageText()
BOX = TEXT.box("Box", (0, 0, 0), (1, 2, 3))
TRIANGLE = """
    def Mesh "{name}" {{
        int[] faceVertexCounts = [3]
        int[] faceVertexIndices = [0, 1, 2]
        point3f[] points = [(0, 0, 0), (1, 0, 0), (0, 1, 0)]
        uniform token subdivisionScheme = "none"
        {more}
    }}
"""


def extract(tmp_path: Path, body: str) -> Extraction:
    return extract_stage(TEXT.write(tmp_path / "scene.usda", body))


def box_of(part: Part) -> list[list[float]]:
    corners = part.triangles.reshape(-1, 3)
    return [corners.min(axis=0).tolist(), corners.max(axis=0).tolist()]


def volume(part: Part) -> float:
    a, b, c = np.moveaxis(part.triangles, 1, 0)
    return float(np.einsum("ij,ij->", a, np.cross(b, c)) / 6)


@pytest.mark.parametrize("up", ["Y", "Z"])
@pytest.mark.parametrize("metres", [1.0, 0.01, 0.0254])
def test_units_and_axes_are_converted_to_metres_z_up(tmp_path: Path, up: str, metres: float) -> None:
    text = StageText(metres, up)
    extraction = extract_stage(text.write(tmp_path / "scene.usda", room_body(text)))
    expected = extract_stage(TEXT.write(tmp_path / "plain.usda", room_body(TEXT)))
    for part, plain in zip(extraction.parts, expected.parts, strict=True):
        assert part.path == plain.path
        assert np.allclose(box_of(part), box_of(plain), atol=1e-6)
        assert volume(part) == pytest.approx(volume(plain), rel=1e-5)


def test_solids_are_wound_outwards(tmp_path: Path) -> None:
    solids = {
        "Cube": ("double size = 2", 8.0),
        "Sphere": ("double radius = 1", 4.19),
        "Cylinder": ('double height = 2\ndouble radius = 1\nuniform token axis = "X"', 6.28),
        "Cone": ('double height = 3\ndouble radius = 1\nuniform token axis = "Y"', 3.14),
        "Capsule": ("double height = 1\ndouble radius = 1", 7.33),
    }
    body = "\n".join(f'def {kind} "{kind}" {{\n{more}\n}}' for kind, (more, _) in solids.items())
    for part, (_, expected) in zip(extract(tmp_path, body).parts, solids.values(), strict=True):
        assert volume(part) == pytest.approx(expected, rel=0.1)


def test_a_mirrored_box_still_faces_outwards(tmp_path: Path) -> None:
    mirror = 'double3 xformOp:scale = (-1, 1, 1)\nuniform token[] xformOpOrder = ["xformOp:scale"]'
    (part,) = extract(tmp_path, f'def Xform "Mirror" {{\n{mirror}\n{BOX}\n}}').parts
    assert volume(part) == pytest.approx(6.0)


def test_left_handed_meshes_are_reoriented(tmp_path: Path) -> None:
    left = TRIANGLE.format(name="Left", more='uniform token orientation = "leftHanded"')
    (part,) = extract(tmp_path, left).parts
    a, b, c = part.triangles[0]
    assert np.cross(b - a, c - a)[2] == -1


def test_an_open_two_sided_mesh_gets_back_faces(tmp_path: Path) -> None:
    (part,) = extract(tmp_path, TRIANGLE.format(name="Sheet", more="uniform bool doubleSided = 1")).parts
    a, b, c = np.moveaxis(part.triangles, 1, 0)
    assert np.cross(b - a, c - a)[:, 2].tolist() == [1, -1]


def test_all_instances_and_payloads_are_extracted(tmp_path: Path) -> None:
    TEXT.write(tmp_path / "prop.usda", BOX)
    arcs = {"Reference": "references = @prop.usda@", "Payload": "payload = @prop.usda@"}
    copies = [
        TEXT.group(f"{name}{number}", "", at=(float(number), 0, 0), head=f"instanceable = true\nprepend {arc}")
        for number, (name, arc) in enumerate(arcs.items())
    ]
    extraction = extract(tmp_path, "\n".join(copies))
    assert [part.path for part in extraction.parts] == ["/World/Reference0/Box", "/World/Payload1/Box"]
    assert [box_of(part)[0][0] for part in extraction.parts] == [0.0, 1.0]
    assert extraction.models == {"/World/Reference0", "/World/Payload1"}


def test_copies_of_a_point_instancer_have_their_positions(tmp_path: Path) -> None:
    instancer = f"""
    def PointInstancer "Crates" {{
        rel prototypes = </World/Crates/Crate>
        int[] protoIndices = [0, 0, 0]
        point3f[] positions = [(0, 0, 0), (5, 0, 0), (9, 0, 0)]
        int64[] invisibleIds = [2]
        {TEXT.group("Crate", BOX)}
    }}"""
    extraction = extract(tmp_path, instancer)
    assert [part.path for part in extraction.parts] == ["/World/Crates/Crate[0]/Box", "/World/Crates/Crate[1]/Box"]
    assert [box_of(part)[0][0] for part in extraction.parts] == [0.0, 5.0]


def test_invisible_prims_and_guides_are_not_extracted(tmp_path: Path) -> None:
    hidden = TEXT.box("Hidden", (0, 0, 0), (1, 1, 1), more='token visibility = "invisible"')
    proxy = TEXT.box("Proxy", (0, 0, 0), (1, 1, 1), more='uniform token purpose = "proxy"')
    guide = TEXT.box("Helper", (0, 0, 0), (1, 1, 1), more='uniform token purpose = "guide"')
    collider = TEXT.box("Box_collision", (0, 0, 0), (1, 1, 1), more='uniform token purpose = "guide"')
    extraction = extract(tmp_path, BOX + hidden + proxy + guide + collider)
    assert [(part.path, part.is_collider) for part in extraction.parts] == [
        ("/World/Box", False),
        ("/World/Box_collision", True),
    ]


def test_a_broken_prim_is_noted_and_the_rest_is_kept(tmp_path: Path) -> None:
    torn = TRIANGLE.format(name="Torn", more="").replace("[0, 1, 2]", "[0, 1, 7]")
    empty = 'def Mesh "Empty" {\n}\n'
    lost = TRIANGLE.format(name="Lost", more="").replace("(1, 0, 0)", "(inf, 0, 0)")
    extraction = extract(tmp_path, torn + empty + lost + BOX)
    assert [part.path for part in extraction.parts] == ["/World/Box"]
    for name in ("Torn", "Empty", "Lost"):
        assert any(f"/World/{name}: " in note for note in extraction.notes)


def test_subsets_bind_their_own_materials(tmp_path: Path) -> None:
    looks = "".join(
        f"""def Material "{name}" {{
            token outputs:surface.connect = </World/{name}/Shader.outputs:surface>
            def Shader "Shader" {{
                uniform token info:id = "UsdPreviewSurface"
                color3f inputs:diffuseColor = {colour}
                token outputs:surface
            }}
        }}
        """
        for name, colour in (("Red", (1, 0, 0)), ("Blue", (0, 0, 1)))
    )
    api = 'prepend apiSchemas = ["MaterialBindingAPI"]'
    mesh = f"""def Mesh "Two" ({api}) {{
        int[] faceVertexCounts = [3, 3]
        int[] faceVertexIndices = [0, 1, 2, 0, 2, 3]
        point3f[] points = [(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0)]
        uniform token subdivisionScheme = "none"
        rel material:binding = </World/Red>
        def GeomSubset "Half" ({api}) {{
            uniform token elementType = "face"
            uniform token familyName = "materialBind"
            int[] indices = [1]
            rel material:binding = </World/Blue>
        }}
    }}"""
    extraction = extract(tmp_path, looks + mesh)
    assert [part.surface.colour for part in extraction.parts] == [(0, 0, 1), (1, 0, 0)]


def test_missing_references_are_reported_and_skipped(tmp_path: Path) -> None:
    lost = TEXT.group("Lost", "", head="prepend references = @nowhere.usda@")
    extraction = extract(tmp_path, lost + BOX)
    assert len(extraction.parts) == 1
    assert any("nowhere.usda" in note for note in extraction.notes)


def test_foreign_units_of_a_layer_are_noted(tmp_path: Path) -> None:
    centimetres = StageText(0.01)
    centimetres.write(tmp_path / "prop.usda", centimetres.box("Box", (0, 0, 0), (1, 1, 1)))
    extraction = extract(tmp_path, TEXT.group("Prop", "", head="prepend references = @prop.usda@"))
    assert any("metersPerUnit 0.01" in note for note in extraction.notes)


@pytest.mark.parametrize("units", ["metersPerUnit = 0", "metersPerUnit = -1"])
def test_invalid_units_are_refused(tmp_path: Path, units: str) -> None:
    path = TEXT.write(tmp_path / "scene.usda", BOX, units=units)
    with pytest.raises(WorldError, match="metersPerUnit"):
        extract_stage(path)


def test_a_missing_file_is_a_usage_error(tmp_path: Path) -> None:
    with pytest.raises(UsageError, match=r"absent\.usd"):
        extract_stage(tmp_path / "absent.usd")


def test_a_file_that_is_not_usd_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "scene.usda"
    path.write_text("hello")
    with pytest.raises(WorldError, match=r"scene\.usda"):
        extract_stage(path)


def test_the_digest_depends_on_the_content_and_not_on_the_path(tmp_path: Path) -> None:
    (tmp_path / "a").mkdir()
    (tmp_path / "b").mkdir()
    one, two = (extract_stage(TEXT.write(tmp_path / place / "scene.usda", BOX)) for place in "ab")
    other = extract(tmp_path, BOX + TEXT.box("More", (0, 0, 0), (1, 1, 1)))
    assert one.sha256 == two.sha256 != other.sha256


def test_a_primvar_with_invalid_indices_drops_the_colour_and_keeps_the_mesh(tmp_path: Path) -> None:
    tint = """color3f[] primvars:displayColor = [(1, 0, 0)] (interpolation = "vertex")
        int[] primvars:displayColor:indices = [0, 0, 7]"""
    extraction = extract(tmp_path, TRIANGLE.format(name="Tinted", more=tint) + BOX)
    assert {part.path for part in extraction.parts} == {"/World/Box", "/World/Tinted"}


def test_a_material_binding_without_its_schema_is_read_without_a_warning_of_usd(
    tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    text = """#usda 1.0
(
    defaultPrim = "Room"
    metersPerUnit = 1
    upAxis = "Z"
)
def Xform "Room"
{
    def Material "Paint"
    {
        token outputs:surface.connect = </Room/Paint/S.outputs:surface>
        def Shader "S"
        {
            uniform token info:id = "UsdPreviewSurface"
            color3f inputs:diffuseColor = (0.7, 0.2, 0.2)
            token outputs:surface
        }
    }
    def Cube "Table"
    {
        rel material:binding = </Room/Paint>
    }
}
"""
    (tmp_path / "room.usda").write_text(text)
    extraction = extract_stage(tmp_path / "room.usda")
    assert capfd.readouterr() == ("", "")
    assert extraction.notes == ()
    assert extraction.parts[0].surface.colour[0] == pytest.approx(0.7)


def test_warnings_of_openusd_of_one_kind_are_one_note_with_their_number() -> None:
    lost = [f"Could not open asset @part_{number}.usda@ for prim </World/Part_{number}>" for number in range(98)]
    kinds = [f"In <kind{'abcdefg'[number]}>: {word} is odd" for number, word in enumerate(["Mass", "Axis", "Mesh"])]
    lines = summarise([*lost, *kinds])
    assert lines[0] == f"{lost[0]} (97 similar warnings of OpenUSD)"
    assert lines[1:] == kinds
    many = [f"{word} is odd" for word in ("Apex", "Bolt", "Cone", "Disc", "Edge", "Face", "Grid")]
    assert summarise(many) == [*many[:5], "2 other warnings of OpenUSD"]


def test_a_stage_with_many_missing_references_has_one_note_on_them(tmp_path: Path) -> None:
    lost = "".join(TEXT.group(f"Lost_{k}", "", head=f"references = @./lost_{k}.usda@") for k in range(40))
    extraction = extract_stage(TEXT.write(tmp_path / "room.usda", room_body(TEXT, lost)))
    (note,) = [note for note in extraction.notes if "lost_" in note]
    assert note.endswith("(39 similar warnings of OpenUSD)")
