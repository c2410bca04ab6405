"""Broken, unusual or hostile stages cause a message with prim or file and the remedy, never a crash."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from factory.scenes.compile.compiler import compile_stage
from factory.scenes.importer import Extraction
from factory.scenes.importer.extract import extract_stage
from factory.scenes.limits import StageLimits
from factory.scenes.rules import CategoryRule, RuleBook
from schemas.errors import WorldError
from tests.builders.stage import StageText, room_body

TEXT = StageText()
BOX = TEXT.box("Box", (0, 0, 0), (1, 2, 3))


def extract(tmp_path: Path, body: str, limits: StageLimits | None = None) -> Extraction:
    return extract_stage(TEXT.write(tmp_path / "scene.usda", body), limits or StageLimits())


def noted(extraction: Extraction, *words: str) -> bool:
    return any(all(word in note for word in words) for note in extraction.notes)


def test_a_stage_without_a_default_prim_is_read_completely_and_noted(tmp_path: Path) -> None:
    path = TEXT.write(tmp_path / "scene.usda", BOX)
    path.write_text(
        path.read_text().replace('defaultPrim = "World"', "").replace('def Xform "World"', 'def Xform "Hall"')
    )
    extraction = extract_stage(path)
    assert len(extraction.parts) == 1
    assert noted(extraction, "defaultPrim", "/Hall")


def test_a_missing_default_prim_is_named_in_a_note(tmp_path: Path) -> None:
    path = TEXT.write(tmp_path / "scene.usda", BOX)
    path.write_text(path.read_text().replace('defaultPrim = "World"', 'defaultPrim = "Hall"'))
    assert noted(extract_stage(path), "'Hall' does not exist", "/World", "deactivate")


@pytest.mark.parametrize("value", ["0", "-1", "1e-12", "1e9"])
def test_the_error_of_an_implausible_unit_states_common_units(tmp_path: Path, value: str) -> None:
    path = TEXT.write(tmp_path / "scene.usda", BOX, units=f"metersPerUnit = {value}")
    with pytest.raises(WorldError, match=r"scene\.usda has metersPerUnit.*0\.01"):
        extract_stage(path)


@pytest.mark.parametrize(
    ("body", "words"),
    [
        ("", ["odd.usda", "contains no visible mesh", "/World", "payloads"]),
        (TEXT.box("Ghost", (0, 0, 0), (9, 9, 1), more='token visibility = "invisible"'), ["/World/Ghost is invisible"]),
        (TEXT.box("Ghost", (0, 0, 0), (9, 9, 1), more='token purpose = "proxy"'), ["/World/Ghost has purpose proxy"]),
        (TEXT.group("Ghost", BOX, head="active = false"), ["/World/Ghost is not active"]),
        (
            TEXT.box("Wall", (0, 0, 0), (5, 0.1, 3)),
            ["odd.usda", "unit 1 m,", "/World/Wall (5 x 0.1 x 3 m)", "no floor", "upAxis"],
        ),
        (TEXT.box("Floor", (0, 0, -1), (8000, 8000, 0)), ["odd.usda", "/World/Floor (8000 x", "grid", "metersPerUnit"]),
    ],
)
def test_the_error_of_a_stage_without_mesh_or_floor_names_file_and_remedy(
    tmp_path: Path, body: str, words: list[str]
) -> None:
    with pytest.raises(WorldError) as caught:
        compile_stage(TEXT.write(tmp_path / "odd.usda", body), "odd", "test")
    assert all(word in str(caught.value) for word in words), str(caught.value)


def test_the_error_of_rules_that_match_nothing_names_some_prims_and_the_remedy(tmp_path: Path) -> None:
    rules = RuleBook(rules=(CategoryRule(category="dragon", include=("dragon",)),))
    path = TEXT.write(tmp_path / "room.usda", room_body(TEXT))
    with pytest.raises(WorldError, match=r"room\.usda has no instance of a known category.*Floor.*--rules"):
        compile_stage(path, "room", "test", rules)


def test_the_error_of_too_many_triangles_names_the_largest_prims_and_the_remedy(tmp_path: Path) -> None:
    ball = 'def Sphere "Ball" {\ndouble radius = 1\n}\n'
    assert len(extract(tmp_path, BOX + ball, StageLimits(max_triangles=1000)).parts) == 2
    with pytest.raises(WorldError, match=r"scene\.usda has more than 100 triangles.*/World/Ball.*--max-triangles"):
        extract(tmp_path, BOX + ball, StageLimits(max_triangles=100))


def test_all_copies_count_towards_the_limit(tmp_path: Path) -> None:
    instancer = f"""
    def PointInstancer "Crates" {{
        rel prototypes = </World/Crates/Box>
        int[] protoIndices = {[0] * 20}
        point3f[] positions = {[(k, 0, 0) for k in range(20)]}
        {BOX}
    }}"""
    with pytest.raises(WorldError, match="more than 100 triangles"):
        extract(tmp_path, instancer, StageLimits(max_triangles=100))


def test_an_oversized_mesh_is_refused_before_triangulation(tmp_path: Path) -> None:
    fan = f"""
    def Mesh "Fan" {{
        int[] faceVertexCounts = [60]
        int[] faceVertexIndices = {[7] * 60}
        point3f[] points = [(0, 0, 0)]
    }}"""
    assert noted(extract(tmp_path, fan + BOX), "/World/Fan", "skipped")  # below the limit, triangulation reports it
    with pytest.raises(WorldError, match=r"more than 50 triangles, exceeded at prim /World/Fan.*/World/Fan \(58\)"):
        extract(tmp_path, fan + BOX, StageLimits(max_triangles=50))


def test_a_cyclic_reference_is_noted_and_the_rest_is_kept(tmp_path: Path) -> None:
    TEXT.write(tmp_path / "other.usda", TEXT.group("Back", "", head="prepend references = @scene.usda@"))
    extraction = extract(tmp_path, TEXT.group("There", "", head="prepend references = @other.usda@") + BOX)
    assert "/World/Box" in [part.path for part in extraction.parts]
    assert noted(extraction, "ycle", "/World/There", "@other.usda@", "remove the circular reference")


def test_usd_warnings_are_the_same_at_every_import(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    lost = TEXT.group("Lost", "", head="references = @nowhere.usda@") + TEXT.group(
        "Loop", "", head="references = </World>"
    )
    notes = []
    for folder in ("here", "there"):
        (tmp_path / folder).mkdir()
        path = TEXT.write(tmp_path / folder / "room.usda", room_body(TEXT, lost))
        monkeypatch.chdir(tmp_path if folder == "here" else path.parent)
        for _ in range(2):
            notes.append(compile_stage(path, "room", "test").info.notes)
    assert len(notes[0]) == 2
    assert notes == [notes[0]] * 4
    assert not any("0x" in note or str(tmp_path) in note for note in notes[0]), notes[0]


@pytest.mark.parametrize("indices", ["[0, 7]", "[0, -1]"])
def test_a_point_instancer_with_wrong_indices_is_skipped_with_a_note(tmp_path: Path, indices: str) -> None:
    instancer = f"""
    def PointInstancer "Crates" {{
        rel prototypes = </World/Crates/Box>
        int[] protoIndices = {indices}
        point3f[] positions = [(0, 0, 0), (5, 0, 0)]
        {BOX}
    }}"""
    extraction = extract(tmp_path, instancer + TEXT.box("Kept", (0, 0, 0), (1, 1, 1)))
    assert [part.path for part in extraction.parts] == ["/World/Kept"]
    assert noted(extraction, "/World/Crates", "1 prototypes")


def test_a_point_instancer_that_copies_itself_is_skipped_with_a_note(tmp_path: Path) -> None:
    instancer = """
    def Xform "Nest" {
        def PointInstancer "Crates" {
            rel prototypes = </World/Nest>
            int[] protoIndices = [0, 0, 0]
            point3f[] positions = [(0, 0, 0), (5, 0, 0), (9, 0, 0)]
        }
    }"""
    extraction = extract(tmp_path, instancer + BOX)
    assert [part.path for part in extraction.parts] == ["/World/Box"]
    assert noted(extraction, "copies itself")


def test_the_file_of_a_missing_payload_is_named_in_a_note(tmp_path: Path) -> None:
    extraction = extract(tmp_path, TEXT.group("Lost", "", head="prepend payload = @nowhere.usda@") + BOX)
    assert [part.path for part in extraction.parts] == ["/World/Box"]
    assert noted(extraction, "nowhere.usda")


def test_a_layer_with_another_unit_is_named_in_a_note(tmp_path: Path) -> None:
    inches = StageText(0.0254)
    inches.write(tmp_path / "prop.usda", inches.box("Box", (0, 0, 0), (1, 1, 1)))
    extraction = extract(tmp_path, TEXT.group("Prop", "", head="prepend references = @prop.usda@"))
    assert noted(extraction, "prop.usda", "metersPerUnit 0.0254")


SPOILING = """
import resource
import sys
from pathlib import Path
import numpy as np
from factory.scenes.importer.extract import extract_stage
from schemas.errors import WorldError
resource.setrlimit(resource.RLIMIT_AS, (4 << 30, 4 << 30))  # a wrong size must not use all memory of the machine
good = Path(sys.argv[1]).read_bytes()
rng = np.random.default_rng(0)
for k in range(40):
    spoilt = bytearray(good[: int(rng.integers(1, len(good)))] if k % 2 else good)
    if k % 2 == 0:
        for place in rng.integers(0, len(good), 20):
            spoilt[place] ^= int(rng.integers(1, 255))
    path = Path(sys.argv[1]).with_name(f"spoilt_{k}.usdc")
    path.write_bytes(spoilt)
    try:
        extract_stage(path)
    except WorldError as error:
        assert path.name in str(error), error
print("survived")
"""


def test_the_error_of_a_corrupt_binary_stage_names_its_file(tmp_path: Path) -> None:
    from pxr import Usd

    path = TEXT.write(tmp_path / "room.usda", room_body(TEXT))
    Usd.Stage.Open(str(path)).Export(str(tmp_path / "room.usdc"))
    words = [
        sys.executable,
        "-c",
        SPOILING,
        str(tmp_path / "room.usdc"),
    ]  # in a separate process: a crash of USD must not end the test session
    done = subprocess.run(words, capture_output=True, text=True, check=False)
    assert done.stdout.strip().endswith("survived"), done.stderr[-2000:]


def textured(file: str) -> str:
    return f"""
    def Material "Print" {{
        token outputs:surface.connect = </World/Print/Shader.outputs:surface>
        def Shader "Shader" {{
            uniform token info:id = "UsdPreviewSurface"
            color3f inputs:diffuseColor.connect = </World/Print/Image.outputs:rgb>
            token outputs:surface
        }}
        def Shader "Image" {{
            uniform token info:id = "UsdUVTexture"
            asset inputs:file = @{file}@
            float4 inputs:fallback = (1, 0, 0, 1)
            float3 outputs:rgb
        }}
    }}
    def Mesh "Poster" (prepend apiSchemas = ["MaterialBindingAPI"]) {{
        int[] faceVertexCounts = [4]
        int[] faceVertexIndices = [0, 1, 2, 3]
        point3f[] points = [(-1, 2.9, 1), (1, 2.9, 1), (1, 2.9, 2), (-1, 2.9, 2)]
        texCoord2f[] primvars:st = [(0, 0), (1, 0), (1, 1), (0, 1)] (interpolation = "vertex")
        uniform token subdivisionScheme = "none"
        rel material:binding = </World/Print>
    }}
    """


@pytest.fixture
def secret(tmp_path: Path) -> Path:
    """An image outside the folder of the stage."""
    (tmp_path / "stage").mkdir()
    Image.fromarray(np.full((8, 8, 3), 77, np.uint8)).save(tmp_path / "secret.png")
    return tmp_path / "secret.png"


@pytest.mark.parametrize("how", ["relative", "absolute", "link"])
def test_a_texture_outside_the_folder_is_not_read(tmp_path: Path, secret: Path, how: str) -> None:
    (tmp_path / "stage" / "link.png").symlink_to(secret)
    file = {"relative": "../secret.png", "absolute": str(secret), "link": "./link.png"}[how]
    path = TEXT.write(tmp_path / "stage" / "room.usda", room_body(TEXT, textured(file)))
    scene = compile_stage(path, "room", "test")
    assert len(scene.textures) == 0
    (note,) = [note for note in scene.info.notes if "outside" in note]
    assert "/World/Print" in note
    assert "--allow-outside" in note
    assert str(tmp_path) not in note
    allowed = compile_stage(path, "room", "test", limits=StageLimits(allow_outside=True))
    assert allowed.textures[0][0, 0].tolist() == [77, 77, 77]


def test_a_refused_texture_shows_its_fallback(tmp_path: Path, secret: Path) -> None:
    extraction = extract_stage(TEXT.write(tmp_path / "stage" / "scene.usda", textured("../secret.png")))
    assert [part.surface.colour for part in extraction.parts] == [(1, 0, 0)]


@pytest.mark.parametrize("file", ["../../etc/nothing.png", "nothing.png"])
def test_a_missing_texture_is_named_in_a_note(tmp_path: Path, file: str) -> None:
    scene = compile_stage(TEXT.write(tmp_path / "room.usda", room_body(TEXT, textured(file))), "room", "test")
    assert any(
        "nothing.png" in note and "one colour" in note and note.startswith(("/World/Poster:", "/World/Print:"))
        for note in scene.info.notes
    )


def test_a_texture_in_the_working_directory_is_not_used(
    tmp_path: Path, secret: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(secret.parent)
    path = TEXT.write(tmp_path / "stage" / "room.usda", room_body(TEXT, textured("secret.png")))
    assert len(compile_stage(path, "room", "test").textures) == 0


def test_a_layer_outside_of_the_folder_is_noted(tmp_path: Path, secret: Path) -> None:
    TEXT.write(tmp_path / "prop.usda", BOX)
    path = TEXT.write(
        tmp_path / "stage" / "scene.usda", TEXT.group("Prop", "", head="prepend references = @../prop.usda@")
    )
    extraction = extract_stage(path)
    assert len(extraction.parts) == 1
    assert noted(extraction, "/World/Prop", "prop.usda", "outside", "move it below")


@pytest.mark.parametrize("place", [b"def Xform", b"World", b'defaultPrim = "', b"upAxis", b"double size"])
def test_a_stage_with_invalid_text_is_refused_or_noted(tmp_path: Path, place: bytes) -> None:
    path = TEXT.write(tmp_path / "odd.usda", room_body(TEXT))
    path.write_bytes(path.read_bytes().replace(place, b"\xff\xfe" + place + b"\xff", 1))
    said = refusal_of(path)
    assert not said or "odd.usda" in said


def refusal_of(path: Path) -> str:
    """Returns why a stage is refused, or an empty text."""
    try:
        extract_stage(path)
    except WorldError as error:
        return str(error)
    return ""
