"""Formats are detected by content; the refusal of a different format names the supported formats and a converter."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from factory.runs.catalog import require_files
from factory.scenes.build import import_scene
from factory.scenes.stage_file import find_fault, kind_of_file
from schemas.errors import InvalidPlan, UsageError
from schemas.plan import Plan, ScenePlan
from schemas.terms import Split
from tests.builders.stage import StageText, room_body

FOREIGN = {
    "shop.fbx": (b"Kaydara FBX Binary  \x00", "FBX", "import_scene.fbx"),
    "shop.blend": (b"BLENDER-v405", "Blender", "blender --background shop.blend"),
    "shop.max": (b"\xd0\xcf\x11\xe0", "not a scene", "export it as glTF or USD"),
    "page.html": (b"<html></html>", "XML", "export it as glTF or USD"),
    "empty.xyz": (b"", "not a scene", "export it as glTF or USD"),
}
KINDS = {
    "shop.glb": (b"glTF\x02\x00\x00\x00", "glTF"),
    "shop.gltf": (json.dumps({"asset": {"version": "2.0"}}).encode(), "glTF"),
    "shop.obj": (b"# exported\nv 0 0 0\n", "OBJ"),
    "shop.dae": (b'<?xml version="1.0"?>\n<COLLADA version="1.4.1">', "COLLADA"),
    "shop.ply": (b"ply\nformat ascii 1.0\n", "PLY"),
    "shop.stl": (b"solid shop\n", "STL"),
    "shop.sdf": (b'<?xml version="1.0"?><!-- <robot> --><sdf version="1.9"/>', "SDF"),
    "shop.world": (b'<sdf version="1.6"><world name="shop"/></sdf>', "SDF"),
    "robot.urdf": (b'<robot name="carter"/>', "URDF"),
    "scene.xml": (b"\xef\xbb\xbf<!-- MuJoCo -->\n<mujoco model='shop'/>", "MJCF"),
    "scene.mjcf": (b"<mujoco/>", "MJCF"),
    "wrong.obj": (b"glTF\x02\x00\x00\x00", "glTF"),
}
DISGUISED = {
    "glTF": b"glTF\x02\x00\x00\x00",
    "FBX": b"; FBX 7.4.0 project file",
    "SDF": b"<sdf version='1.9'/>",
    "XML": b"<html></html>",
    "Blender": b"BLENDER17-01v0500",
}


def stage(folder: Path) -> Path:
    text = StageText()
    return text.write(folder / "room.usda", room_body(text))


@pytest.mark.parametrize("name", KINDS)
def test_a_readable_format_is_detected_by_its_content_then_by_its_suffix(tmp_path: Path, name: str) -> None:
    content, kind = KINDS[name]
    (tmp_path / name).write_bytes(content)
    assert kind_of_file(tmp_path / name) == kind
    assert find_fault(tmp_path / name) == ""


@pytest.mark.parametrize("name", FOREIGN)
def test_the_error_of_an_unsupported_format_names_the_supported_ones_and_a_converter(tmp_path: Path, name: str) -> None:
    content, kind, remedy = FOREIGN[name]
    path = tmp_path / name
    path.write_bytes(content)
    fault = find_fault(path)
    assert fault.startswith(f"{path} is ")
    assert kind in fault
    assert ".usd, .usda, .usdc, .usdz, .gltf, .glb" in fault
    assert remedy in fault
    assert "usdchecker" not in fault


@pytest.mark.parametrize("name", FOREIGN)
def test_importing_an_unsupported_format_is_a_usage_error_and_writes_nothing(tmp_path: Path, name: str) -> None:
    (tmp_path / name).write_bytes(FOREIGN[name][0])
    with pytest.raises(UsageError, match=r"supported are \.usd, .*\.glb"):
        import_scene(tmp_path / name, "shop", tmp_path / "cache")
    assert not (tmp_path / "cache").exists()


@pytest.mark.parametrize("name", FOREIGN)
def test_a_plan_that_names_a_file_of_an_unsupported_format_is_refused(tmp_path: Path, name: str) -> None:
    (tmp_path / name).write_bytes(FOREIGN[name][0])
    shop = ScenePlan(name="shop", usd=str(tmp_path / name), seen=("chair",), episodes=2)
    with pytest.raises(InvalidPlan) as caught:
        require_files(Plan(name="mine", scenes=(shop,), splits={Split.TRAIN_ID: 1.0}))
    (finding,) = caught.value.findings
    assert finding.startswith("scenes[0] shop: file: ")
    assert FOREIGN[name][2] in finding


@pytest.mark.parametrize("suffix", [".usd", ".usda", ".usdc", ".usdz"])
@pytest.mark.parametrize("kind", DISGUISED)
def test_another_format_with_a_usd_suffix_is_detected_by_its_first_bytes(
    tmp_path: Path, kind: str, suffix: str
) -> None:
    path = tmp_path / f"room{suffix}"
    path.write_bytes(DISGUISED[kind])
    assert f"contains {kind}, but has the suffix of a USD stage" in find_fault(path)


def test_the_error_of_a_stage_with_a_wrong_suffix_names_the_right_suffix(tmp_path: Path) -> None:
    from pxr import Usd, UsdUtils

    text = stage(tmp_path)
    crate, packed = tmp_path / "c.usdc", tmp_path / "p.usdz"
    opened = Usd.Stage.Open(str(text))  # kept alive: a layer without its stage is freed
    opened.GetRootLayer().Export(str(crate))
    assert UsdUtils.CreateNewUsdzPackage(str(crate), str(packed))
    opens = {text: (".usd", ".usda", ".USDA"), crate: (".usd", ".usdc"), packed: (".usdz",)}
    for source, suffixes in opens.items():
        for suffix in (".usd", ".usda", ".USDA", ".usdc", ".usdz", ".txt", ""):
            if source is packed and suffix in {".txt", ""}:
                continue  # without its suffix, it could be any zip archive
            path = tmp_path / f"copy{suffix}"
            path.write_bytes(source.read_bytes())
            fault = find_fault(path)
            assert (fault == "") is (suffix in suffixes), (source, suffix, fault)
            if fault:
                assert f"USD opens as copy{suffixes[-1].lower()}; rename the file" in fault
            else:
                assert Usd.Stage.Open(str(path))


def test_a_directory_and_a_missing_file_have_different_messages(tmp_path: Path) -> None:
    assert "is a directory; give the scene's root file" in find_fault(tmp_path)
    assert find_fault(tmp_path / "w.usda").startswith(f"no scene file at {tmp_path}/w.usda")
