"""Features of single formats: transforms, textures, instances, frames, includes and conventions."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from factory.scenes.formats import extract_scene
from factory.scenes.importer import Extraction, Part
from factory.scenes.limits import StageLimits
from schemas.errors import WorldError
from tests.builders.formats import Gltf, dae_room, mjcf_room, obj_room, picture, sdf_room, urdf_room

SQUARE = [(0.0, 0.0, 0.0), (2.0, 0.0, 0.0), (2.0, 0.0, -2.0), (0.0, 0.0, -2.0)]
TRIANGLE_OBJ = "v 0 0 0\nv 1 0 0\nv 0 1 0\nvt 0 0\nvt 1 0\nvt 0 1\nusemtl print\nf 1/1 2/2 3/3\n"


def write(path: Path, content: str | bytes) -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(content.encode() if isinstance(content, str) else content)
    return path


def part_of(extraction: Extraction, path: str) -> Part:
    (found,) = [part for part in extraction.parts if part.path == path]
    return found


def box_of(part: Part) -> list[list[float]]:
    flat = part.triangles.reshape(-1, 3)
    return [np.round(flat.min(axis=0), 4).tolist(), np.round(flat.max(axis=0), 4).tolist()]


def test_nodes_of_gltf_compose_translation_rotation_scale_and_matrix(tmp_path: Path) -> None:
    document = Gltf()
    mesh = document.mesh(SQUARE, [0, 1, 2, 0, 2, 3])
    turned = document.node("Turned", mesh, is_root=False, rotation=[0, 2**-0.5, 0, 2**-0.5], scale=[2, 1, 1])
    matrix = [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 10, 0, 0, 1]
    document.node("Parent", matrix=matrix, children=[turned])
    extraction = extract_scene(write(tmp_path / "a.glb", document.glb()))
    # the square becomes 4 x 2 m; a quarter turn about y takes x to -z, which is y of the world
    assert box_of(part_of(extraction, "/World/Parent/Turned")) == [[8, 0, 0], [10, 4, 0]]


def test_texture_transforms_strips_and_colours_of_gltf_are_applied(tmp_path: Path) -> None:
    document = Gltf()
    picture(tmp_path)
    texture = document.add("textures", {"source": document.add("images", {"uri": "tiles.png"})})
    moved = {"KHR_texture_transform": {"offset": [0.5, 0.25], "scale": [2, 4], "texCoord": 1}}
    base = {"baseColorTexture": {"index": texture, "extensions": moved}}
    material = document.add("materials", {"pbrMetallicRoughness": base, "doubleSided": True})
    uvs = document.accessor([(0, 0), (255, 0), (0, 255), (255, 255)], "VEC2", "B", normalized=True)
    strip = [SQUARE[0], SQUARE[1], SQUARE[3], SQUARE[2]]
    document.node(
        "Strip", document.mesh(strip, [0, 1, 2, 3], material=material, mode=5, attributes={"TEXCOORD_1": uvs})
    )
    tints = document.accessor([(0.5, 0, 0, 1)] * 4, "VEC4", "f")
    document.node("Tinted", document.mesh(SQUARE, [0, 1, 2], attributes={"COLOR_0": tints}))
    extraction = extract_scene(write(tmp_path / "a.glb", document.glb()))
    strip_part = part_of(extraction, "/World/Strip")
    assert len(strip_part.triangles) == 4  # two triangles, each with both sides
    assert strip_part.uvs is not None
    assert strip_part.uvs[0].tolist() == [[0.5, 0.75], [2.5, 0.75], [0.5, -3.25]]
    assert strip_part.surface.texture == str(tmp_path / "tiles.png")
    tinted = part_of(extraction, "/World/Tinted")
    assert tinted.tints is not None
    assert tinted.tints[0, 0].tolist() == [0.5, 0, 0]


def test_instances_sparse_values_and_equal_names_of_gltf_are_resolved(tmp_path: Path) -> None:
    document = Gltf()
    mesh = document.mesh(SQUARE, [0, 1, 2])
    places = document.accessor([(0, 0, 0), (5, 0, 0)], "VEC3", "f")
    document.node("Tile", mesh, extensions={"EXT_mesh_gpu_instancing": {"attributes": {"TRANSLATION": places}}})
    document.node("Tile", mesh)
    rows, raised = document.accessor([1], "SCALAR", "H"), document.accessor([(9, 0, 0)], "VEC3", "f")
    views = [document.json["accessors"][index]["bufferView"] for index in (rows, raised)]
    indices = {"bufferView": views[0], "componentType": 5123}
    document.json["accessors"][0]["sparse"] = {"count": 1, "indices": indices, "values": {"bufferView": views[1]}}
    extraction = extract_scene(write(tmp_path / "a.glb", document.glb()))
    assert [part.path for part in extraction.parts] == ["/World/Tile/copy[0]", "/World/Tile/copy[1]", "/World/Tile_1"]
    assert box_of(extraction.parts[1]) == [[5, 0, 0], [14, 2, 0]]


def test_unit_and_up_axis_of_collada_are_applied_and_can_be_overridden(tmp_path: Path) -> None:
    plain = extract_scene(write(tmp_path / "z.dae", dae_room(tmp_path)))
    turned = extract_scene(write(tmp_path / "y.dae", dae_room(tmp_path, unit=0.01, up="Y_UP")))
    assert turned.metres_per_unit == 0.01
    for one, other in zip(plain.parts, turned.parts, strict=True):
        assert np.allclose(one.triangles, other.triangles, atol=1e-5)
    lying = extract_scene(tmp_path / "z.dae", StageLimits(up="y"))
    assert max(part.triangles[..., 2].max() for part in lying.parts) == pytest.approx(3.2)


def test_a_unit_in_metres_scales_the_scene(tmp_path: Path) -> None:
    path = write(tmp_path / "z.dae", dae_room(tmp_path))
    for one, half in zip(extract_scene(path).parts, extract_scene(path, StageLimits(unit=0.5)).parts, strict=True):
        assert np.allclose(one.triangles / 2, half.triangles)


def test_scenes_of_another_unit_or_up_axis_have_another_digest(tmp_path: Path) -> None:
    path = write(tmp_path / "z.dae", dae_room(tmp_path))
    limits = (StageLimits(), StageLimits(unit="m"), StageLimits(unit=0.5), StageLimits(up="y"), StageLimits(up="z"))
    extractions = [extract_scene(path, each) for each in limits]
    assert len({extraction.files_sha256 for extraction in extractions}) == len(limits)
    assert len({extraction.sha256 for extraction in extractions}) == len(limits)


def test_a_world_places_included_models_in_nested_frames(tmp_path: Path) -> None:
    box = "<geometry><box><size>1 1 1</size></box></geometry>"
    write(
        tmp_path / "models" / "crate" / "crate.sdf",
        f"""<sdf version="1.7"><model name="crate"><pose>100 0 0 0 0 0</pose>
        <frame name="top"><pose>0 0 1 0 0 0</pose></frame>
        <link name="body"><pose relative_to="top">0 0 1 0 0 0</pose><visual name="shape"><pose>0 0 1 0 0 0</pose>{box}
        <material><script><name>Gazebo/Red</name></script></material></visual></link></model></sdf>""",
    )
    config = '<model><sdf version="1.4">old.sdf</sdf><sdf version="1.7">crate.sdf</sdf></model>'
    write(tmp_path / "models" / "crate" / "model.config", config)
    body = """<include><uri>model://crate</uri><name>first</name><pose>5 0 0 0 0 1.5707963267948966</pose></include>
        <model name="pair"><pose degrees="true">0 5 0 0 0 90</pose>
        <include><uri>model://crate</uri><pose>1 0 0 0 0 0</pose></include>
        <include><uri>model://crate</uri><name>second</name></include></model>"""
    extraction = extract_scene(write(tmp_path / "w.sdf", sdf_room(body)))
    assert box_of(part_of(extraction, "/World/first/body/shape")) == [[4.5, -0.5, 2.5], [5.5, 0.5, 3.5]]
    assert box_of(part_of(extraction, "/World/pair/crate/body/shape")) == [[-0.5, 5.5, 2.5], [0.5, 6.5, 3.5]]
    assert "/World/pair/second/body/shape" in {part.path for part in extraction.parts}
    assert "/World/pair" in extraction.groups  # it contains two models
    assert {"/World/first", "/World/pair/crate"} <= extraction.models
    assert part_of(extraction, "/World/first/body/shape").surface.colour == (1.0, 0.0, 0.0)


def mesh_world(folder: Path) -> str:
    """Writes a textured OBJ mesh, and returns an SDF model that references it."""
    picture(folder)
    write(folder / "meshes" / "tri.mtl", "newmtl print\nKd 1 1 1\nmap_Kd ../tiles.png\n")
    write(folder / "meshes" / "tri.obj", "mtllib tri.mtl\n" + TRIANGLE_OBJ)
    mesh = "<geometry><mesh><uri>meshes/tri.obj</uri><scale>2 2 -2</scale></mesh></geometry>"
    link = f"<visual name='v'>{mesh}</visual><collision name='c'>{mesh}</collision>"
    return f"<model name='tri'><link name='l'>{link}</link></model>"


def test_a_textured_mesh_of_a_world_keeps_its_texture_and_is_mirrored(tmp_path: Path) -> None:
    extraction = extract_scene(write(tmp_path / "w.sdf", sdf_room(mesh_world(tmp_path))))
    shown, solid = (part for part in extraction.parts if part.path.startswith("/World/tri"))
    assert (shown.surface.texture, shown.is_collider, solid.is_collider) == (str(tmp_path / "tiles.png"), False, True)
    assert shown.uvs is not None
    assert shown.triangles.max() == 2.0
    assert any(len(digest) == 64 for digest in (extraction.sha256, extraction.files_sha256))


def test_an_albedo_map_replaces_the_material_of_a_mesh(tmp_path: Path) -> None:
    model = mesh_world(tmp_path)
    Path(tmp_path / "other.png").write_bytes((tmp_path / "tiles.png").read_bytes())
    pbr = "</geometry><material><pbr><metal><albedo_map>other.png</albedo_map></metal></pbr></material></visual>"
    extraction = extract_scene(write(tmp_path / "w.sdf", sdf_room(model.replace("</geometry></visual>", pbr))))
    shown = next(part for part in extraction.parts if part.path.startswith("/World/tri"))
    assert shown.surface.texture == str(tmp_path / "other.png")


def test_joints_of_urdf_place_their_links_and_package_names_are_resolved(tmp_path: Path) -> None:
    mesh_world(tmp_path / "share" / "shop")
    more = """<link name="shelf"><visual><origin xyz="1 0 0"/><geometry>
        <mesh filename="package://shop/meshes/tri.obj"/></geometry></visual></link>
        <joint name="j" type="revolute"><parent link="SM_Chair_01"/><child link="shelf"/>
        <origin xyz="0 0 1" rpy="0 0 1.5707963267948966"/><axis xyz="0 0 1"/></joint>"""
    path = write(tmp_path / "shop.urdf", urdf_room(more))
    extraction = extract_scene(path, StageLimits(models=(tmp_path / "share",)))
    (shelf,) = [part for part in extraction.parts if part.path.startswith("/World/SM_Chair_01/shelf")]
    assert box_of(shelf) == [[1.0, 2.0, 1.45], [2.0, 3.0, 1.45]]  # chair at (2, 1, 0.45), turned by 90 degrees
    assert shelf.surface.texture == str(tmp_path / "share" / "shop" / "tiles.png")


def link(name: str, parent: str = "", joint: str = "fixed") -> str:
    box = '<visual><geometry><box size="1 1 1"/></geometry></visual>'
    ends = f'<parent link="{parent}"/><child link="{name}"/>'
    return f'<link name="{name}">{box}</link>' + (
        f'<joint name="to_{name}" type="{joint}">{ends}</joint>' if parent else ""
    )


def test_drawers_and_handles_of_urdf_are_parts_of_their_cabinet_and_fixed_links_are_not(tmp_path: Path) -> None:
    links = [
        link("handle", "drawer"),  # listed before its parent
        '<link name="world"/>',  # has no shape: it supports objects and is not an object
        link("cabinet", "world"),
        link("table", "world", "prismatic"),
        link("drawer", "cabinet", "prismatic"),
        link("oven", "cabinet"),
    ]
    extraction = extract_scene(write(tmp_path / "a.urdf", f'<robot name="r">{"".join(links)}</robot>'))
    assert sorted({part.path.rpartition("/")[0] for part in extraction.parts}) == [
        "/World/cabinet",
        "/World/cabinet/drawer",
        "/World/cabinet/drawer/handle",
        "/World/oven",
        "/World/table",
    ]
    assert extraction.models == {"/World/cabinet", "/World/oven", "/World/table", "/World/world"}
    assert extraction.articulated == {"/World/cabinet"}


def test_textures_are_found_from_a_relative_model_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    mesh_world(tmp_path / "share" / "shop")
    mesh = '<mesh filename="package://shop/meshes/tri.obj"/>'
    more = f'<link name="shelf"><visual><geometry>{mesh}</geometry></visual></link>'
    path = write(tmp_path / "shop.urdf", urdf_room(more))
    monkeypatch.chdir(tmp_path)
    extraction = extract_scene(Path(path.name), StageLimits(models=(Path("share"),)))
    (shelf,) = [part for part in extraction.parts if part.path.startswith("/World/shelf")]
    assert shelf.surface.texture == str(tmp_path / "share" / "shop" / "tiles.png")


def test_ply_and_collada_keep_their_texture(tmp_path: Path) -> None:
    picture(tmp_path)
    head = "ply\nformat ascii 1.0\ncomment TextureFile tiles.png\nelement vertex 3\n"
    head += "".join(f"property float {name}\n" for name in ("x", "y", "z", "s", "t"))
    head += "element face 1\nproperty list uchar int vertex_indices\nend_header\n"
    path = write(tmp_path / "a.ply", head + "0 0 0 0 0\n2 0 0 1 0\n0 2 0 0 1\n3 0 1 2\n")
    (part,) = extract_scene(path, StageLimits(unit="m", up="z")).parts
    assert part.uvs is not None
    assert part.surface.texture == str(tmp_path / "tiles.png")
    image = '<library_images><image id="i"><init_from>tiles.png</init_from></image></library_images>'
    params = """<newparam sid="s"><surface type="2D"><init_from>i</init_from></surface></newparam>
        <newparam sid="p"><sampler2D><source>s</source></sampler2D></newparam><technique sid="t"><lambert>
        <diffuse><texture texture="p" texcoord="UV"/>"""
    text = dae_room(tmp_path).replace("<library_effects>", image + "<library_effects>")
    start = text.index('<technique sid="t">')
    text = text[:start] + params + text[text.index("</diffuse>") :]
    floor = next(part for part in extract_scene(write(tmp_path / "a.dae", text)).parts if "Floor" in part.path)
    assert floor.surface.texture == str(tmp_path / "tiles.png")


def test_concave_polygons_and_relative_indices_of_obj_are_read(tmp_path: Path) -> None:
    arrow = "v 0 0 0\nv 4 0 0\nv 4 4 0\nv 2 1 0\nv 0 4 0\nf -5 -4 -3 -2 -1\n"
    (part,) = extract_scene(write(tmp_path / "a.obj", arrow), StageLimits(unit="m", up="z")).parts
    a, b, c = np.moveaxis(part.triangles, 1, 0)
    area = np.linalg.norm(np.cross(b - a, c - a), axis=1).sum() / 2
    assert area == pytest.approx(2 * 10.0)  # both sides; a triangle fan would cover more than the polygon
    textured = obj_room(tmp_path)
    room = extract_scene(write(tmp_path / "room.obj", textured), StageLimits(unit="m", up="z"))
    rug = part_of(room, "/World/Rug")
    assert rug.uvs is not None
    assert rug.uvs[0].tolist() == [[0, 0], [1, 0], [1, 1]]


def test_mjcf_resolves_defaults_includes_angles_and_proxies(tmp_path: Path) -> None:
    pytest.importorskip("mujoco")
    write(
        tmp_path / "parts" / "shelf.xml",
        """<mujocoinclude><body name="shelf" pos="2 0 1" euler="0 0 90"><geom class="board" name="board"/>
        <geom name="proxy" type="box" size="1 0.5 0.15" group="0"/></body></mujocoinclude>""",
    )
    geom = '<geom type="box" size="1 0.5 0.1" contype="0" conaffinity="0" group="1" rgba="1 0 0 1"/>'
    default = f'<default><default class="board">{geom}</default></default>'
    text = mjcf_room(tmp_path, '<include file="parts/shelf.xml"/>').replace("<worldbody>", default + "<worldbody>")
    extraction = extract_scene(write(tmp_path / "room.xml", text))
    board = part_of(extraction, "/World/shelf/board")
    assert box_of(board) == [[1.5, -1.0, 0.9], [2.5, 1.0, 1.1]]
    assert board.surface.colour == (1.0, 0.0, 0.0)
    assert part_of(extraction, "/World/shelf/proxy").is_collider
    assert "/World/shelf" in extraction.models
    (tmp_path / "tiles.png").unlink()
    with pytest.raises(WorldError, match=r"missing .*: tiles\.png \(of texture tiles\)"):
        extract_scene(tmp_path / "room.xml")


@pytest.mark.parametrize("lines", ["d 1\nTr 1", "Tr 1\nd 1", "Tr 0", "d 1"])
def test_an_opaque_material_of_mtl_is_opaque_although_tr_contradicts_d(tmp_path: Path, lines: str) -> None:
    write(tmp_path / "a.mtl", f"newmtl print\nKd 1 0 0\n{lines}\n")
    extraction = extract_scene(
        write(tmp_path / "a.obj", f"mtllib a.mtl\n{TRIANGLE_OBJ}"), StageLimits(unit="m", up="z")
    )
    assert [part.surface.opacity for part in extraction.parts] == [1.0]


@pytest.mark.parametrize("name", ["hitbox.001", "Hit_Box", "UCX_Chair", "collision_box-2"])
def test_hit_boxes_of_games_are_for_collision_only(tmp_path: Path, name: str) -> None:
    document = Gltf()
    mesh = document.mesh(SQUARE, [0, 1, 2, 0, 2, 3])
    document.node("Chair", mesh, children=[document.node(name, mesh, is_root=False)])
    document.node("HitboxPoster", mesh)
    extraction = extract_scene(write(tmp_path / "a.glb", document.glb()))
    assert [part.is_collider for part in extraction.parts] == [False, True, False]


def test_unknown_elements_of_urdf_are_noted_and_the_room_is_read(tmp_path: Path) -> None:
    text = (
        urdf_room().replace("<visual>", "<colour_hint/><visual><shade>1</shade>").replace("</link>", "<gazebo/></link>")
    )
    extraction, plain = (
        extract_scene(write(tmp_path / name, content)) for name, content in (("a.urdf", text), ("b.urdf", urdf_room()))
    )
    assert [part.path for part in extraction.parts] == [part.path for part in plain.parts]
    assert [note for note in extraction.notes if "URDF" in note] == [
        "elements of links that URDF does not define are ignored: <colour_hint>, <shade>"
    ]
    assert not any("URDF" in note for note in plain.notes)
