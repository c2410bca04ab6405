"""Reads Wavefront OBJ files and their MTL materials: objects, groups, polygons, texture coordinates, vertex colours.

Lines, points, curves and normals are ignored.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from factory.scenes.formats.files import SceneFiles, place_of
from factory.scenes.formats.shapes import Content, Names, ShapeNode, display_colour, mesh_piece
from factory.scenes.importer.collect import Piece
from factory.scenes.importer.content import Surface
from factory.scenes.importer.polygons import triangulate
from schemas.appearance.colour_names import linear_of
from schemas.support.numpy_types import Floats, Ints

_TEXTURE_OPTIONS = {"-s": 3, "-o": 3, "-t": 3, "-mm": 2, "-bm": 1, "-blendu": 1, "-blendv": 1, "-clamp": 1, "-boost": 1}
_KINDS = ("v", "vt", "f", "o", "g", "usemtl", "mtllib")


@dataclass
class _Faces:
    """Faces of one object with one material."""

    counts: list[int] = field(default_factory=list)
    corners: list[str] = field(default_factory=list)
    """`v`, `v/vt`, `v//vn` or `v/vt/vn`; relative indices are already absolute."""


@dataclass
class _Lines:
    """Content of the file by kind of line."""

    points: list[list[str]] = field(default_factory=list)
    uvs: list[list[str]] = field(default_factory=list)
    libraries: list[str] = field(default_factory=list)
    faces: dict[tuple[str, str], _Faces] = field(default_factory=dict)
    """(object, material) -> faces, in the order of the file."""


def read_obj(data: bytes, path: Path, files: SceneFiles) -> Content:
    """Reads an OBJ file.

    Args:
        data: content of the file.
        path: path of the file; materials and textures are relative to it.
        files: files of the import.

    Raises:
        ValueError: a number or an index is not valid.
        WorldError: the file has too many triangles.
    """
    lines = _split(data.decode("utf-8-sig", errors="replace"))
    count = sum(max(size - 2, 0) for faces in lines.faces.values() for size in faces.counts)
    files.scene.require_room(path.name, count)
    surfaces = _surfaces(lines.libraries, path, files)
    points, colours = _points(lines.points)
    uvs = np.array([line[:2] for line in lines.uvs], np.float64).reshape(-1, 2)
    content, names = Content(metres_per_unit=None, up=None), Names()
    objects: dict[str, list[Piece]] = {}
    for (name, material), faces in lines.faces.items():
        if material and material not in surfaces:
            files.scene.notes.append(f"{path.name}: material {material} is not defined; object {name} is shown in grey")
        piece, note = _piece(faces, points, colours, uvs, surfaces.get(material, Surface()))
        files.scene.notes += [f"{path.name}: object {name or 'object'}: {note}"] if note else []
        objects.setdefault(name, []).append(piece)
    for name, pieces in objects.items():
        content.shapes.append(ShapeNode(names.path("", name, "object"), tuple(pieces), np.eye(4)))
    return content


def _split(text: str) -> _Lines:
    lines, name, group, material = _Lines(), "", "", ""
    for words in _words(text):
        kind, *rest = words
        if kind == "v":
            lines.points.append(rest)
        elif kind == "vt":
            lines.uvs.append(rest)
        elif kind == "f":
            faces = lines.faces.setdefault((name or group, material), _Faces())
            faces.counts.append(len(rest))
            faces.corners += [_absolute(corner, lines) for corner in rest] if "-" in "".join(rest) else rest
        elif kind == "o":
            name = " ".join(rest)
        elif kind == "g":
            group = " ".join(rest)
        elif kind == "usemtl":
            material = " ".join(rest)
        else:
            lines.libraries.append(" ".join(rest))
    return lines


def _words(text: str) -> Iterator[list[str]]:
    """Yields the words of each line of a known kind; joins continued lines."""
    for line in text.replace("\\\n", " ").replace("\\\r\n", " ").splitlines():
        words = line.split()
        if words and words[0] in _KINDS:
            yield words


def _absolute(corner: str, lines: _Lines) -> str:
    lengths = (len(lines.points), len(lines.uvs), 0)
    indices = corner.split("/")
    return "/".join(
        str(length + 1 + int(index)) if index.startswith("-") else index
        for index, length in zip(indices, lengths, strict=False)
    )


def _points(lines: list[list[str]]) -> tuple[Floats, Floats | None]:
    """Returns the vertices (N, 3), and their linear colours (N, 3) if every vertex has one."""
    points = np.array([line[:3] for line in lines], np.float64).reshape(-1, 3)
    has_colours = bool(lines) and all(len(line) >= 6 for line in lines)
    colours = np.array([line[3:6] for line in lines], np.float64) if has_colours else None
    return points, None if colours is None else linear_of(np.clip(colours, 0.0, 1.0))


def _piece(faces: _Faces, points: Floats, colours: Floats | None, uvs: Floats, surface: Surface) -> tuple[Piece, str]:
    """Returns the faces as a piece, and a note if their texture coordinates cannot be used."""
    parts = [corner.split("/") for corner in faces.corners]
    vertices = np.array([part[0] for part in parts], np.int64) - 1
    cut = triangulate(points, np.array(faces.counts, np.int64), vertices)
    corners = vertices[cut.corners]
    rows = np.array([part[1] if len(part) > 1 and part[1] else 0 for part in parts], np.int64) - 1
    note = _unusable(rows, uvs, surface)
    values = None if note or not len(rows) or rows.min() < 0 else np.asarray(uvs[rows][cut.corners])
    tints = None if colours is None else colours[corners]
    return mesh_piece(points, corners, surface=surface, uvs=values, tints=tints), note


def _unusable(rows: Ints, uvs: Floats, surface: Surface) -> str:
    """Returns a note on texture coordinates that do not exist, or an empty string; row -1 means none."""
    if len(rows) and (rows.max() >= len(uvs) or rows.min() < -1):
        low, high = rows.min() + 1, rows.max() + 1
        return f"texture coordinates {low} to {high} are used, but there are {len(uvs)}; shown without texture"
    if surface.texture and len(rows) and rows.min() < 0:
        return "textured, but some faces are without texture coordinates; shown in one colour"
    return ""


def _surfaces(libraries: list[str], path: Path, files: SceneFiles) -> dict[str, Surface]:
    surfaces: dict[str, Surface] = {}
    for name in dict.fromkeys(libraries):
        place = place_of(path.parent, name)
        if files.readable.encloses(str(place)) and place.is_file():
            surfaces |= read_mtl(files.read(place).decode("utf-8-sig", errors="replace"), place.parent, files)
        else:
            files.scene.notes.append(f"{path.name}: material library {name} is missing or outside; shown in grey")
    return surfaces


def read_mtl(text: str, folder: Path, files: SceneFiles) -> dict[str, Surface]:
    """Returns the appearance of each material of an MTL file: Kd, map_Kd, d, Tr and Ke.

    Raises:
        ValueError: a number is not valid.
    """
    surfaces_by_name: dict[str, Surface] = {}
    dissolved: set[str] = set()  # `d` has precedence over `Tr`: SketchUp writes `d 1` and `Tr 1` for opaque materials
    name = ""
    for line in text.splitlines():
        key, _, rest = line.strip().partition(" ")
        key, rest = key.lower(), rest.strip()
        surface = surfaces_by_name.get(name, Surface())
        if key == "newmtl":
            name = rest
            surfaces_by_name[name] = Surface(name=name)
        elif key == "kd":
            colour = display_colour(*_triple(rest))
            surfaces_by_name[name] = replace(surface, colour=colour, fallback=colour)
        elif key == "map_kd":
            surfaces_by_name[name] = files.textured(surface, folder, _file_of(rest), f"material {name}")
        elif key == "d" or (key == "tr" and name not in dissolved):
            value = float(rest.split()[-1])
            surfaces_by_name[name] = replace(surface, opacity=value if key == "d" else 1.0 - value)
            dissolved |= {name} if key == "d" else set()
        elif key == "ke":
            glow = display_colour(*_triple(rest))
            surfaces_by_name[name] = replace(surface, emits=max(glow) > 0.05, emission=glow)
    return {name: _white_factor(surface) for name, surface in surfaces_by_name.items()}


def _white_factor(surface: Surface) -> Surface:
    """Returns the surface. If the factor of a texture is black, which many exporters write, it is replaced by white."""
    is_black = surface.texture and max(surface.colour) <= 0.0
    return replace(surface, colour=(1.0, 1.0, 1.0)) if is_black else surface


def _triple(text: str) -> tuple[float, float, float]:
    red, green, blue = (float(word) for word in (text.split() * 3)[:3])
    return red, green, blue


def _file_of(text: str) -> str:
    """Returns the file name of a texture statement without its options."""
    words = text.split(" ")
    while words and words[0] in _TEXTURE_OPTIONS:
        most = _TEXTURE_OPTIONS[words.pop(0)]
        for _ in range(most):
            if len(words) > 1 and (_is_number(words[0]) or words[0] in ("on", "off")):
                words.pop(0)
    return " ".join(words).strip()


def _is_number(word: str) -> bool:
    try:
        float(word)
    except ValueError:
        return False
    return True
