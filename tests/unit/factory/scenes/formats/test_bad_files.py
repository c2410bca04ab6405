"""Scene files that cannot be read cause a message with the reason and the remedy; nothing is written."""

from __future__ import annotations

import os
import re
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from factory.scenes.build import import_scene
from factory.scenes.formats import extract_scene
from factory.scenes.limits import StageLimits
from schemas.errors import UsageError, WorldError
from schemas.scene import decode_scene
from tests.builders.formats import (
    LAUGHS,
    ROOM,
    Gltf,
    dae_room,
    gltf_room,
    mjcf_room,
    picture,
    sdf_room,
    stl_room,
    urdf_room,
    write_room,
)

METRES = StageLimits(unit="m", up="z")


def write(path: Path, content: str | bytes) -> Path:
    path.write_bytes(content.encode() if isinstance(content, str) else content)
    return path


@pytest.mark.parametrize("suffix", [".obj", ".stl", ".ply"])
def test_the_error_of_a_file_without_unit_and_axis_names_both_options_and_the_size_for_each_unit(
    tmp_path: Path, suffix: str
) -> None:
    path = write_room(tmp_path, suffix)
    with pytest.raises(UsageError) as caught:
        extract_scene(path)
    for words in (
        f"room{suffix} does not state",
        "--unit m|cm|mm|in|METRES",
        "--up y|z",
        "8.4 x 6.4 x 2.6 m with m",
        "with in",
    ):
        assert words in str(caught.value)
    with pytest.raises(UsageError, match="does not state its up axis"):
        extract_scene(path, StageLimits(unit="m"))


def test_the_error_of_an_implausible_unit_states_the_size_for_each_unit(tmp_path: Path) -> None:
    path = write(tmp_path / "room.stl", stl_room())
    with pytest.raises(WorldError, match=r"room\.stl is 0\.0084 m wide.*8\.4 x 6\.4 x 2\.6 m with m.*--unit"):
        extract_scene(path, StageLimits(unit="mm", up="z"))


@pytest.mark.parametrize("suffix", [".sdf", ".urdf"])
def test_a_unit_for_a_format_that_defines_it_is_refused(tmp_path: Path, suffix: str) -> None:
    with pytest.raises(UsageError, match="defines its unit and up axis; remove --unit and --up"):
        extract_scene(write_room(tmp_path, suffix), METRES)


def test_a_truncated_glb_is_refused_at_every_length(tmp_path: Path) -> None:
    data = gltf_room(tmp_path).glb()
    for length in (4, 11, 12, 30, len(data) // 2, len(data) - 1):
        path = write(tmp_path / "room.glb", data[:length])
        with pytest.raises(WorldError, match=r"room\.glb is not a readable glTF file: the file is truncated"):
            extract_scene(path)


def test_a_node_whose_values_exceed_the_buffer_is_skipped_with_a_note(tmp_path: Path) -> None:
    document = gltf_room(tmp_path)
    document.json["accessors"][0]["count"] = 1 << 40
    extraction = extract_scene(write(tmp_path / "room.glb", document.glb()))
    assert any(note.startswith("/Floor: skipped, 1099511627776 values") for note in extraction.notes)


def test_a_file_above_the_limit_is_refused_before_it_is_read(tmp_path: Path) -> None:
    path = write(tmp_path / "big.glb", b"glTF\2\0\0\0")
    os.truncate(path, 2_000_000_000)  # a sparse file
    with pytest.raises(WorldError, match=r"big\.glb has 2000 MB; the limit of one file is 1000 MB.*--max-file-mb"):
        extract_scene(path)


@pytest.mark.parametrize("limit", [71, 20])
def test_too_many_triangles_are_refused_in_every_format(tmp_path: Path, limit: int) -> None:
    for suffix in (".glb", ".obj", ".stl", ".ply", ".dae", ".sdf", ".urdf"):
        given = StageLimits(max_triangles=limit, unit="m", up="z") if suffix in {".obj", ".stl", ".ply"} else None
        with pytest.raises(WorldError, match=f"more than {limit} triangles.*--max-triangles"):
            extract_scene(write_room(tmp_path, suffix), given or StageLimits(max_triangles=limit))


BOMBS: dict[str, Callable[[Path], str]] = {
    "room.sdf": lambda _: sdf_room(head=LAUGHS),
    "room.urdf": lambda _: urdf_room(head=LAUGHS),
    "room.xml": lambda folder: mjcf_room(folder, head=LAUGHS),
    "room.dae": lambda folder: dae_room(folder, head=LAUGHS),
}


@pytest.mark.parametrize("name", BOMBS)
def test_xml_entities_are_refused_and_nothing_is_written(tmp_path: Path, name: str) -> None:
    if name == "room.xml":
        pytest.importorskip("mujoco")
    path = write(tmp_path / name, BOMBS[name](tmp_path))
    with pytest.raises(WorldError, match="declares XML entities"):
        import_scene(path, "room", tmp_path / "cache")
    assert not (tmp_path / "cache").exists()


def test_deeply_nested_xml_is_refused(tmp_path: Path) -> None:
    deep = "<model name='m'>" * 5000 + "</model>" * 5000
    with pytest.raises(WorldError, match="nested more than 200 deep"):
        extract_scene(write(tmp_path / "deep.sdf", sdf_room(deep)))


def include(uri: str, more: str = "") -> str:
    return f"<include><uri>{uri}</uri>{more}</include>"


def test_all_missing_models_are_named_with_the_searched_folders(tmp_path: Path) -> None:
    uris = ("model://sofa", "model://table", "https://fuel.gazebosim.org/1.0/lamp")
    path = write(tmp_path / "house.sdf", sdf_room("".join(map(include, uris))))
    with pytest.raises(WorldError) as caught:
        import_scene(path, "house", tmp_path / "cache", limits=StageLimits(models=(tmp_path / "more",)))
    for words in (*uris, str(tmp_path / "more"), str(tmp_path / "models"), "--model-dir DIR", "on the network"):
        assert words in str(caught.value)
    assert not (tmp_path / "cache").exists()


def test_a_world_is_read_without_its_missing_models_and_meshes_on_request(tmp_path: Path) -> None:
    gone = "<mesh><uri>file://models/lamp/lamp.dae</uri></mesh>"
    model = f"<model name='m'><link name='l'><visual name='v'><geometry>{gone}</geometry></visual></link></model>"
    path = write(tmp_path / "house.sdf", sdf_room(include("model://sofa") + model))
    with pytest.raises(WorldError, match=r"model://sofa.*import without them with --skip-missing"):
        extract_scene(path)
    extraction = extract_scene(path, StageLimits(skip_missing=True))
    assert len(extraction.parts) == len(extract_scene(write_room(tmp_path, ".sdf")).parts)
    lost = [note for note in extraction.notes if note.endswith("is missing, skipped")]
    assert len(lost) == 2
    assert any("model://sofa" in note for note in lost)
    assert any("models/lamp/lamp.dae" in note for note in lost)


def test_the_error_of_a_robot_file_without_a_floor_names_the_option_that_adds_a_floor(tmp_path: Path) -> None:
    rest = re.sub(r'<link name="Floor".*?</link>|<joint name="to_Floor".*?</joint>', "", urdf_room(), flags=re.DOTALL)
    path = write(tmp_path / "room.urdf", rest)
    with pytest.raises(WorldError, match=r"if the file has no ground, add one with --floor 0"):
        import_scene(path, "room", tmp_path / "cache")
    assert [file.name for file in (tmp_path / "cache").iterdir()] == ["room.map.png"]
    with import_scene(path, "room", tmp_path / "cache", limits=StageLimits(floor_m=0.0)).open("rb") as file:
        scene = decode_scene(file)
    assert scene.info.floor_height_m == pytest.approx(0.0, abs=1e-6)
    assert [target.category for target in scene.info.targets] == ["chair"]


def test_a_relative_uri_is_searched_in_the_folders_of_models(tmp_path: Path) -> None:
    mesh = "<mesh><uri>file://models/lamp/lamp.obj</uri></mesh>"
    model = f"<model name='m'><link name='l'><visual name='v'><geometry>{mesh}</geometry></visual></link></model>"
    (tmp_path / "models" / "lamp").mkdir(parents=True)
    (tmp_path / "worlds").mkdir()
    write(tmp_path / "models" / "lamp" / "lamp.obj", "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n")
    path = write(tmp_path / "worlds" / "w.sdf", sdf_room(model))
    found = extract_scene(path, StageLimits(models=(tmp_path,)))
    assert any("/m/l/v" in part.path for part in found.parts)


@pytest.mark.parametrize("uri", ["../secret.obj", "file:///etc/hostname", "model://../secret.obj"])
def test_a_mesh_outside_of_the_folder_is_refused(tmp_path: Path, uri: str) -> None:
    write(tmp_path / "secret.obj", "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n")
    (tmp_path / "world").mkdir()
    mesh = f"<model name='m'><link name='l'><visual name='v'><geometry><mesh><uri>{uri}</uri></mesh></geometry>"
    path = write(tmp_path / "world" / "w.sdf", sdf_room(mesh + "</visual></link></model>"))
    with pytest.raises(WorldError, match=r"outside of the scene's folder.*--allow-outside"):
        extract_scene(path)
    if uri.startswith("../"):
        found = extract_scene(path, StageLimits(allow_outside=True))
        assert any("/m/l/v" in part.path for part in found.parts)


def test_a_buffer_of_gltf_outside_of_the_folder_is_refused(tmp_path: Path) -> None:
    document = gltf_room(tmp_path)
    (tmp_path / "in").mkdir()
    write(tmp_path / "room.bin", document.data)
    path = write(tmp_path / "in" / "room.gltf", document.gltf())
    text = path.read_text()
    start, end = text.index("data:application"), text.index('"', text.index("data:application"))
    path.write_text(text[:start] + "../room.bin" + text[end:])
    with pytest.raises(WorldError, match="outside of the scene's folder"):
        extract_scene(path)
    assert len(extract_scene(path, StageLimits(allow_outside=True)).parts) == len(ROOM) + 2


def test_a_model_that_includes_itself_is_noted(tmp_path: Path) -> None:
    write(tmp_path / "loop.sdf", f'<sdf version="1.9"><model name="loop">{include("loop.sdf")}</model></sdf>')
    extraction = extract_scene(write(tmp_path / "w.sdf", sdf_room(include("loop.sdf"))))
    assert any("includes itself" in note for note in extraction.notes)


def test_points_that_are_not_finite_are_noted_and_the_rest_is_kept(tmp_path: Path) -> None:
    document = gltf_room(tmp_path)
    bad = document.mesh([(float("nan"), 0, 0), (1, 0, 0), (0, 1, 0)], [0, 1, 2])
    document.node("Broken", bad)
    extraction = extract_scene(write(tmp_path / "room.glb", document.glb()))
    assert "/Broken: skipped, points are not finite" in extraction.notes
    assert len(extraction.parts) == len(ROOM) + 2


def test_triangles_without_area_are_imported_without_an_error(tmp_path: Path) -> None:
    path = write(tmp_path / "flat.obj", "v 0 0 0\nv 4 0 0\nv 4 4 0\nf 1 2 3\nf 1 1 2\nf 2 2 2\n")
    extraction = extract_scene(path, METRES)
    assert np.isfinite(extraction.parts[0].triangles).all()


@pytest.mark.parametrize(
    ("extension", "verb"),
    [
        ("KHR_draco_mesh_compression", "copy"),
        ("EXT_meshopt_compression", "copy"),
        ("KHR_texture_basisu", "ktxdecompress"),
    ],
)
def test_the_error_of_a_compressed_gltf_names_its_extension_and_a_command(
    tmp_path: Path, extension: str, verb: str
) -> None:
    # `npx @gltf-transform/cli copy` and `ktxdecompress` were run (4.5.1); the package `gltf-transform` does not exist
    document = gltf_room(tmp_path)
    document.json["extensionsRequired"] = [extension]
    path = write(tmp_path / "my room.glb", document.glb())
    with pytest.raises(WorldError) as caught:
        extract_scene(path)
    command = f"npx @gltf-transform/cli {verb} '{path}' '{tmp_path}/plain_my room.glb'"
    assert f"it needs {extension}, not supported; export it without, or: {command}" in str(caught.value)


@pytest.mark.parametrize("has_plain", [True, False])
def test_a_mesh_with_optional_draco_is_read_uncompressed_or_noted_with_a_command(
    tmp_path: Path, has_plain: bool
) -> None:
    document = gltf_room(tmp_path)
    primitive = document.json["meshes"][0]["primitives"][0]
    primitive["extensions"] = {"KHR_draco_mesh_compression": {"bufferView": 0}}
    if not has_plain:
        del document.json["accessors"][primitive["attributes"]["POSITION"]]["bufferView"]
    extraction = extract_scene(write(tmp_path / "room.glb", document.glb()))
    noted = [note for note in extraction.notes if "npx @gltf-transform/cli copy room.glb plain_room.glb" in note]
    assert bool(noted) is not has_plain
    assert any(part.path == "/World/Floor" for part in extraction.parts) is has_plain


def test_a_missing_material_library_and_material_are_noted(tmp_path: Path) -> None:
    path = write_room(tmp_path, ".obj")
    (tmp_path / "room.mtl").unlink()
    extraction = extract_scene(path, METRES)
    assert any("material library room.mtl is missing" in note for note in extraction.notes)
    assert any("material SM_Chair_01 is not defined" in note for note in extraction.notes)


def test_the_error_of_a_pointer_of_git_lfs_names_the_command_that_downloads_the_file(tmp_path: Path) -> None:
    path = write(tmp_path / "room.glb", "version https://git-lfs.github.com/spec/v1\noid sha256:0\nsize 9\n")
    with pytest.raises(UsageError, match=r"pointer of Git LFS.*git lfs pull"):
        extract_scene(path)


XACRO = 'xmlns:xacro="http://www.ros.org/wiki/xacro"'


@pytest.mark.parametrize(
    ("name", "line", "found", "target"),
    [
        ("room.urdf", '<xacro:include filename="a"/>', "line 3 contains <xacro:include>", "room_expanded.urdf"),
        ("room.urdf", '<link name="${side}"/>', r"line 3 contains the xacro expression \${side}", "room_expanded.urdf"),
        ("room.urdf", '<link name="$(arg side)"/>', "line 3 contains the xacro expression", "room_expanded.urdf"),
        ("my room.urdf.xacro", '<xacro:box n="a"/>', "line 3 contains <xacro:box>", "'.*/my room.urdf'"),
        ("room.xacro", '<xacro:box n="a"/>', "line 3 contains <xacro:box>", "room.urdf"),
    ],
)
def test_xacro_macros_are_refused_with_a_command_that_writes_another_file(
    tmp_path: Path, name: str, line: str, found: str, target: str
) -> None:
    # `xacro FILE -o OTHER` was run (2.1); `xacro FILE > FILE` empties the file
    path = write(tmp_path / name, f"<robot {XACRO}>\n<!-- ${{a}} <xacro:b/> -->\n{line}</robot>")
    with pytest.raises(WorldError, match=f"{found}.*; expand it first: xacro .*{name}'? -o .*{target}"):
        extract_scene(path)


@pytest.mark.parametrize("declared", [XACRO, ""])
def test_elements_of_xacro_that_are_left_in_a_link_are_ignored_with_a_note(tmp_path: Path, declared: str) -> None:
    text = urdf_room('\n<link name="extra"><xacro:box_inertial x="1"/><sensor:ray/></link>')
    path = write(tmp_path / "room.urdf", text.replace("<robot", f"<robot {declared}"))
    extraction = extract_scene(path)
    assert any(re.fullmatch(r"line \d+: <xacro:box_inertial> is not expanded, ignored", n) for n in extraction.notes)
    assert any("prefixes without declaration" in note and "sensor" in note for note in extraction.notes)
    assert len(extraction.parts) == len(extract_scene(write_room(tmp_path, ".urdf")).parts)


@pytest.mark.parametrize("root", ["model.config", "model.sdf", "room.sdf"])
def test_a_bare_ampersand_is_read_as_text_with_a_note_that_names_the_file(tmp_path: Path, root: str) -> None:
    config = '<model><name>a</name><sdf version="1.6">model.sdf</sdf></model>'
    texts = {"model.config": config, "model.sdf": crate(), "room.sdf": sdf_room(include("model://crate"))}
    more = "<description>crate & lid &amp; &#38; &lid;<![CDATA[a & b]]></description></"
    texts[root] = more.join(texts[root].rsplit("</", 1))
    for name, text in texts.items():
        write(tmp_path / name if name == "room.sdf" else folder_of(tmp_path, "models/crate") / name, text)
    extraction = extract_scene(tmp_path / "room.sdf")
    place = root if root == "room.sdf" else f"models/crate/{root}"
    assert f"{place}: 2 bare & read as text" in extraction.notes
    assert any("/crate/" in part.path for part in extraction.parts)


def test_a_malformed_model_config_is_named_and_the_model_is_read_from_its_usual_file(tmp_path: Path) -> None:
    folder = folder_of(tmp_path, "models/crate")
    write(folder / "model.config", "<model><sdf>")
    path = write(tmp_path / "room.sdf", sdf_room(include("model://crate")))
    with pytest.raises(WorldError, match=r"folders without an SDF file.*models/crate"):
        extract_scene(path)
    write(folder / "model.sdf", crate())
    extraction = extract_scene(path)
    (note,) = [note for note in extraction.notes if "not valid XML" in note]
    assert note.startswith("models/crate/model.config: it is not valid XML")
    assert note.endswith("model.sdf is read")
    assert any("/crate/" in part.path for part in extraction.parts)
    write(folder / "model.sdf", "<sdf>")
    assert any("models/crate/model.sdf: it is not valid XML" in note for note in extract_scene(path).notes)


def folder_of(folder: Path, name: str) -> Path:
    (folder / name).mkdir(parents=True, exist_ok=True)
    return folder / name


def crate() -> str:
    visual = "<visual name='v'><geometry><box><size>1 1 1</size></box></geometry></visual>"
    return f"<sdf version='1.6'><model name='crate'><link name='l'>{visual}</link></model></sdf>"


def test_a_loop_of_nodes_or_joints_is_refused(tmp_path: Path) -> None:
    document = Gltf()
    document.node("A", children=[0])
    with pytest.raises(WorldError, match="node 0 is its own descendant"):
        extract_scene(write(tmp_path / "loop.glb", document.glb()))
    joint = '<joint name="j" type="fixed"><parent link="SM_Chair_01"/><child link="base"/></joint>'
    with pytest.raises(WorldError, match="joints form a loop"):
        extract_scene(write(tmp_path / "loop.urdf", urdf_room(joint)))


SQUARES_OBJ = """o Floor
v -3 -3 0
v 3 -3 0
v 3 3 0
v -3 3 0
usemtl print
f 1/1 2/1 3/1 4/1
"""


@pytest.mark.parametrize(
    ("uvs", "note"),
    [
        ("", "texture coordinates 1 to 1 are used, but there are 0; shown without texture"),
        ("vt 0 0\nf 1/7 2/1 3/1", "texture coordinates 1 to 7 are used, but there are 1; shown without texture"),
        ("vt 0 0\nf 1 2 3", "textured, but some faces are without texture coordinates; shown in one colour"),
    ],
)
def test_an_object_with_absent_texture_coordinates_is_drawn_without_texture_with_a_note(
    tmp_path: Path, uvs: str, note: str
) -> None:
    picture(tmp_path)
    write(tmp_path / "a.mtl", "newmtl print\nKd 0.1 0.8 0.1\nmap_Kd tiles.png\n")
    path = write(tmp_path / "room.obj", f"mtllib a.mtl\n{SQUARES_OBJ}{uvs}\n")
    extraction = extract_scene(path, METRES)
    assert extraction.notes == (f"room.obj: object Floor: {note}",)
    (part,) = extraction.parts
    assert part.uvs is None
    assert part.triangles[..., 2].max() == 0


def test_texture_coordinates_and_colours_that_are_too_few_in_gltf_are_noted(tmp_path: Path) -> None:
    document = gltf_room(tmp_path)
    count = 0
    for mesh in document.json["meshes"]:
        for primitive in mesh["primitives"]:
            attributes = primitive["attributes"]
            attributes["COLOR_0"] = document.accessor([(1.0, 0, 0)], "VEC3", "f")
            if "TEXCOORD_0" in attributes:
                count += 1
                attributes["TEXCOORD_0"] = document.accessor([(0.0, 0.0)], "VEC2", "f")
    extraction = extract_scene(write(tmp_path / "room.glb", document.glb()))
    assert len(extraction.parts) == len(ROOM) + 2
    assert sum("textured but without texture coordinates" in note for note in extraction.notes) == count > 0
    assert any("1 vertex colours for" in note for note in extraction.notes)


@pytest.mark.parametrize(("semantic", "params"), [("TEXCOORD", "ST"), ("NORMAL", "XYZ")])
def test_a_mesh_of_collada_with_too_few_texture_coordinates_or_normals_is_kept(
    tmp_path: Path, semantic: str, params: str
) -> None:
    names = "".join(f'<param name="{name}" type="float"/>' for name in params)
    source = f"""<source id="u"><float_array id="ua" count="{len(params)}">{"0 " * len(params)}</float_array>
        <technique_common><accessor source="#ua" count="1" stride="{len(params)}">{names}</accessor></technique_common>
        </source><vertices"""
    room, counts = dae_room(tmp_path).replace("<vertices", source, 1), "<vcount>4 4 4 4 4 4 </vcount>"
    text = room.replace(counts, f'<input semantic="{semantic}" source="#u" offset="0" set="0"/>{counts}', 1)
    assert text != room
    extraction = extract_scene(write(tmp_path / "room.dae", text))
    assert len(extraction.parts) == len(ROOM)
    noted = f"room.dae {ROOM[0].name}-g: texture coordinates 0 to 7 are used, but there are 1; shown without texture"
    assert extraction.notes == ((noted,) if semantic == "TEXCOORD" else ())


def test_a_part_of_collada_that_cannot_be_read_is_noted(tmp_path: Path) -> None:
    text = dae_room(tmp_path).replace(f'<instance_geometry url="#{ROOM[0].name}-g"', '<instance_geometry url="#absent"')
    extraction = extract_scene(write(tmp_path / "room.dae", text))
    assert len(extraction.parts) == len(ROOM) - 1
    assert any(note.startswith("room.dae: ") and "absent" in note for note in extraction.notes)
