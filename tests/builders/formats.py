"""Writes one room in every 3D format that can be imported: floor, four walls and a red chair, in metres, z up.

The texts are written by hand, so no writer shares code with the readers. Uses the standard library and Pillow.
"""

from __future__ import annotations

import base64
import json
import struct
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

from PIL import Image

Vector3 = tuple[float, float, float]


class Box(NamedTuple):
    """Axis-aligned box."""

    name: str
    low: Vector3
    high: Vector3
    colour: Vector3 = (0.5, 0.5, 0.5)
    """sRGB."""


CHAIR = Box("SM_Chair_01", (1.8, 0.8, 0.0), (2.2, 1.2, 0.9), (0.8, 0.05, 0.05))
ROOM = (
    Box("Floor", (-4.2, -3.2, -0.1), (4.2, 3.2, 0.0)),
    Box("WallWest", (-4.2, -3.2, 0), (-4, 3.2, 2.5)),
    Box("WallEast", (4, -3.2, 0), (4.2, 3.2, 2.5)),
    Box("WallSouth", (-4, -3.2, 0), (4, -3, 2.5)),
    Box("WallNorth", (-4, 3, 0), (4, 3.2, 2.5)),
    CHAIR,
)
QUADS = ((0, 3, 2, 1), (4, 5, 6, 7), (0, 1, 5, 4), (1, 2, 6, 5), (2, 3, 7, 6), (3, 0, 4, 7))
TRIANGLES = tuple(corner for a, b, c, d in QUADS for corner in (a, b, c, a, c, d))
LAUGHS = '<!DOCTYPE x [<!ENTITY a "ha"><!ENTITY b "&a;&a;&a;&a;">]>'


def corners(box: Box) -> list[Vector3]:
    (x0, y0, z0), (x1, y1, z1) = box.low, box.high
    return [(x, y, z) for z in (z0, z1) for x, y in ((x0, y0), (x1, y0), (x1, y1), (x0, y1))]


def middle(box: Box) -> Vector3:
    x, y, z = ((a + b) / 2 for a, b in zip(box.low, box.high, strict=True))
    return x, y, z


def size(box: Box) -> Vector3:
    x, y, z = (b - a for a, b in zip(box.low, box.high, strict=True))
    return x, y, z


def text(values: Any) -> str:
    return " ".join(f"{value:.9g}" for value in values)


def picture(folder: Path, name: str = "tiles.png") -> Path:
    folder.mkdir(parents=True, exist_ok=True)
    Image.new("RGB", (8, 8), (40, 90, 200)).save(folder / name)
    return folder / name


class Gltf:
    """A glTF document with one buffer."""

    def __init__(self) -> None:
        self.data = b""
        self.json: dict[str, Any] = {"asset": {"version": "2.0"}, "scene": 0, "scenes": [{"nodes": []}]}

    def add(self, key: str, item: Mapping[str, Any]) -> int:
        self.json.setdefault(key, []).append(dict(item))
        return len(self.json[key]) - 1

    def view(self, data: bytes) -> int:
        view = self.add("bufferViews", {"buffer": 0, "byteOffset": len(self.data), "byteLength": len(data)})
        self.data += data + b"\0" * (-len(data) % 4)
        return view

    def accessor(self, values: list[Any], kind: str, code: str, **more: Any) -> int:
        component = {"f": 5126, "H": 5123, "I": 5125, "B": 5121}[code]
        width = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4}[kind]
        flat = [number for value in values for number in (value if width > 1 else (value,))]
        view = self.view(struct.pack(f"<{len(flat)}{code}", *flat))
        item = {"bufferView": view, "componentType": component, "count": len(values), "type": kind, **more}
        return self.add("accessors", item)

    def mesh(self, points: list[Vector3], indices: list[int], **primitive: Any) -> int:
        attributes = {"POSITION": self.accessor(points, "VEC3", "f"), **primitive.pop("attributes", {})}
        order = self.accessor(indices, "SCALAR", "H")
        return self.add("meshes", {"primitives": [{"attributes": attributes, "indices": order, **primitive}]})

    def node(self, name: str, mesh: int | None = None, is_root: bool = True, **more: Any) -> int:
        item = {"name": name, **({} if mesh is None else {"mesh": mesh}), **more}
        node = self.add("nodes", item)
        if is_root:
            self.json["scenes"][0]["nodes"].append(node)
        return node

    def box(self, box: Box, **more: Any) -> int:
        """Adds a box, rotated from z up to y up."""
        colour = [value**2.2 for value in box.colour]
        material = self.add("materials", {"pbrMetallicRoughness": {"baseColorFactor": [*colour, 1.0]}})
        mesh = self.mesh([(x, z, -y) for x, y, z in corners(box)], list(TRIANGLES), material=material)
        return self.node(box.name, mesh, **more)

    def glb(self) -> bytes:
        document = json.dumps({**self.json, "buffers": [{"byteLength": len(self.data)}]}).encode()
        document += b" " * (-len(document) % 4)
        chunks = struct.pack("<II", len(document), 0x4E4F534A) + document
        chunks += struct.pack("<II", len(self.data), 0x004E4942) + self.data
        return struct.pack("<4sII", b"glTF", 2, 12 + len(chunks)) + chunks

    def gltf(self) -> bytes:
        uri = "data:application/octet-stream;base64," + base64.b64encode(self.data).decode()
        return json.dumps({**self.json, "buffers": [{"byteLength": len(self.data), "uri": uri}]}).encode()


def gltf_room(folder: Path) -> Gltf:
    """The room with a texture on its floor, a label on its chair, a light and a collider."""
    document = Gltf()
    for box in ROOM:
        extras = {"extras": {"semantic": "chair"}} if box is CHAIR else {}
        document.box(box, **extras)
    image = document.add("images", {"bufferView": document.view(picture(folder).read_bytes()), "mimeType": "image/png"})
    texture = document.add("textures", {"source": image})
    material = document.add("materials", {"pbrMetallicRoughness": {"baseColorTexture": {"index": texture}}})
    points = [(-1.0, 0.001, 1.0), (1.0, 0.001, 1.0), (1.0, 0.001, -1.0), (-1.0, 0.001, -1.0)]
    uvs = document.accessor([(0, 1), (1, 1), (1, 0), (0, 0)], "VEC2", "f")
    rug = document.mesh(points, [0, 1, 2, 0, 2, 3], material=material, attributes={"TEXCOORD_0": uvs})
    document.node("Rug", rug)
    document.box(CHAIR._replace(name="UCX_Chair"))
    document.node("Lamp", extensions={"KHR_lights_punctual": {"light": 0}})
    return document


def obj_room(folder: Path) -> str:
    picture(folder)
    lines, first = ["mtllib room.mtl"], 1
    materials = ["newmtl print\nKd 1 1 1\nmap_Kd -s 1 1 1 tiles.png"]
    for box in ROOM:
        materials.append(f"newmtl {box.name}\nKd {text(box.colour)}")
        lines += [f"o {box.name}", f"usemtl {box.name}", *(f"v {text(point)}" for point in corners(box))]
        lines += ["f " + " ".join(str(first + corner) for corner in quad) for quad in QUADS]
        first += 8
    lines += ["o Rug", "usemtl print", "v -1 -1 0.001", "v 1 -1 0.001", "v 1 1 0.001", "v -1 1 0.001"]
    lines += ["vt 0 0", "vt 1 0", "vt 1 1", "vt 0 1", "f -4/-4 -3/-3 -2/-2 -1/-1"]
    (folder / "room.mtl").write_text("\n".join(materials))
    return "\n".join(lines)


def stl_room() -> str:
    lines = []
    for box in ROOM:
        points = corners(box)
        lines.append(f"solid {box.name}")
        for start in range(0, len(TRIANGLES), 3):
            loop = "".join(f"vertex {text(points[corner])}\n" for corner in TRIANGLES[start : start + 3])
            lines.append(f"facet normal 0 0 0\nouter loop\n{loop}endloop\nendfacet")
        lines.append(f"endsolid {box.name}")
    return "\n".join(lines)


def ply_room() -> str:
    points = [(*point, *(round(255 * c) for c in box.colour)) for box in ROOM for point in corners(box)]
    faces = [[8 * number + corner for corner in quad] for number in range(len(ROOM)) for quad in QUADS]
    head = (
        f"ply\nformat ascii 1.0\nelement vertex {len(points)}\nproperty float x\nproperty float y\nproperty float z\n"
    )
    head += "property uchar red\nproperty uchar green\nproperty uchar blue\n"
    head += f"element face {len(faces)}\nproperty list uchar int vertex_indices\nend_header\n"
    return head + "\n".join([*(text(point) for point in points), *(f"4 {text(face)}" for face in faces)]) + "\n"


def dae_room(folder: Path, head: str = "", unit: float = 1.0, up: str = "Z_UP") -> str:
    picture(folder)
    effects, materials, meshes, nodes = "", "", "", ""
    for box in ROOM:
        flat = text(value / unit for point in corners(box) for value in (point if up == "Z_UP" else _y_up(point)))
        effects += f"""<effect id="{box.name}-fx"><profile_COMMON><technique sid="t"><lambert><diffuse>
            <color>{text(box.colour)} 1</color></diffuse></lambert></technique></profile_COMMON></effect>"""
        materials += f'<material id="{box.name}-m"><instance_effect url="#{box.name}-fx"/></material>'
        meshes += f"""<geometry id="{box.name}-g"><mesh><source id="{box.name}-p">
            <float_array id="{box.name}-a" count="24">{flat}</float_array><technique_common>
            <accessor source="#{box.name}-a" count="8" stride="3"><param name="X" type="float"/>
            <param name="Y" type="float"/><param name="Z" type="float"/></accessor></technique_common></source>
            <vertices id="{box.name}-v"><input semantic="POSITION" source="#{box.name}-p"/></vertices>
            <polylist count="6" material="m"><input semantic="VERTEX" source="#{box.name}-v" offset="0"/>
            <vcount>{"4 " * 6}</vcount><p>{text(c for quad in QUADS for c in quad)}</p></polylist></mesh></geometry>"""
        nodes += f"""<node id="{box.name}" name="{box.name}"><instance_geometry url="#{box.name}-g"><bind_material>
            <technique_common><instance_material symbol="m" target="#{box.name}-m"/></technique_common>
            </bind_material></instance_geometry></node>"""
    return f"""<?xml version="1.0"?>{head}<COLLADA xmlns="http://www.collada.org/2005/11/COLLADASchema" version="1.4.1">
        <asset><unit meter="{unit}"/><up_axis>{up}</up_axis></asset>
        <library_effects>{effects}</library_effects><library_materials>{materials}</library_materials>
        <library_geometries>{meshes}</library_geometries><library_visual_scenes><visual_scene id="s">{nodes}
        </visual_scene></library_visual_scenes><scene><instance_visual_scene url="#s"/></scene></COLLADA>"""


def _y_up(point: Vector3) -> Vector3:
    return point[0], point[2], -point[1]


def sdf_room(more: str = "", head: str = "", root: str = "world") -> str:
    models = ""
    for box in ROOM:
        geometry = f"<geometry><box><size>{text(size(box))}</size></box></geometry>"
        models += f"""<model name="{box.name}"><pose>{text(middle(box))} 0 0 0</pose><link name="link">
            <collision name="collision">{geometry}</collision><visual name="visual">{geometry}
            <material><diffuse>{text(box.colour)} 1</diffuse></material></visual></link></model>"""
    light = '<light name="sun" type="directional"/>'
    return f'<?xml version="1.0"?>{head}<sdf version="1.9"><{root} name="room">{models}{light}{more}</{root}></sdf>'


def urdf_room(more: str = "", head: str = "") -> str:
    links, joints = '<link name="base"/>', ""
    for box in ROOM:
        geometry = f'<geometry><box size="{text(size(box))}"/></geometry>'
        links += f"""<link name="{box.name}"><visual>{geometry}<material name="{box.name}">
            <color rgba="{text(box.colour)} 1"/></material></visual><collision>{geometry}</collision></link>"""
        joints += f"""<joint name="to_{box.name}" type="fixed"><parent link="base"/><child link="{box.name}"/>
            <origin xyz="{text(middle(box))}"/></joint>"""
    return f'<?xml version="1.0"?>{head}<robot name="room">{links}{joints}{more}</robot>'


def mjcf_room(folder: Path, more: str = "", head: str = "") -> str:
    picture(folder)
    geoms = ""
    for box in ROOM:
        half = text(value / 2 for value in size(box))
        geoms += f"""<body name="{box.name}" pos="{text(middle(box))}"><geom type="box" size="{half}"
            rgba="{text(box.colour)} 1"/><geom type="box" size="{half}" group="3"/></body>"""
    return f"""{head}<mujoco model="room"><asset><texture name="tiles" type="2d" file="tiles.png"/>
        <material name="tiles" texture="tiles"/></asset><worldbody><light pos="0 0 2"/>
        <geom name="Rug" type="plane" size="1 1 0.1" pos="0 0 0.001" material="tiles"/>{geoms}{more}</worldbody>
        </mujoco>"""


def write_room(folder: Path, suffix: str) -> Path:
    """Writes the room as `room` + suffix; suffixes: .glb, .gltf, .obj, .stl, .ply, .dae, .sdf, .urdf, .xml."""
    if suffix in (".glb", ".gltf"):
        document = gltf_room(folder)
        data = document.glb() if suffix == ".glb" else document.gltf()
    else:
        writers = {
            ".obj": lambda: obj_room(folder),
            ".stl": stl_room,
            ".ply": ply_room,
            ".dae": lambda: dae_room(folder),
            ".sdf": sdf_room,
            ".urdf": urdf_room,
            ".xml": lambda: mjcf_room(folder),
        }
        data = writers[suffix]().encode()
    path = folder / f"room{suffix}"
    path.write_bytes(data)
    return path
