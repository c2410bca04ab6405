"""Finds and reads the files to which a world refers: models and meshes, by path, model:// or package:// name.

Reads each mesh once. Records missing files, so one error names all of them.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from pathlib import Path
from urllib.parse import quote, unquote

import numpy as np

from factory.scenes.formats.collada import read_collada
from factory.scenes.formats.files import SceneFiles, place_of
from factory.scenes.formats.gltf import read_gltf
from factory.scenes.formats.meshes import read_ply, read_stl
from factory.scenes.formats.obj import read_obj
from factory.scenes.formats.shapes import BROKEN, Content, ShapeNode, place_content, solid_piece, to_metres
from factory.scenes.formats.xml_text import text_of
from factory.scenes.importer.content import Surface
from factory.scenes.importer.solids import Polygons
from factory.scenes.stage_file import kind_of_file
from schemas.support.numpy_types import Floats

NAMED = ("model://", "package://")
REMOTE = ("http://", "https://", "fuel://")
_MESHES = {"COLLADA": read_collada, "OBJ": read_obj, "PLY": read_ply, "STL": read_stl}


_FUEL_HOSTS = ("fuel.gazebosim.org", "fuel.ignitionrobotics.org")


def fuel_name(uri: str) -> tuple[str, str, str, str]:
    """Returns owner, model, version and file of a URI of Fuel: `https://HOST/1.0/OWNER/models/NAME[/VERSION[/files/...]]`.

    All are empty but the model, the last segment, if the URI has another form.
    """
    steps = unquote(uri).partition("://")[2].strip("/").split("/")
    if "models" not in steps[1:-1]:
        return "", steps[-1], "", ""
    place = steps.index("models", 1)
    owner, name, *rest = steps[place - 1], *steps[place + 1 :]
    version = rest.pop(0) if rest and (rest[0].isdigit() or rest[0] == "tip") else ""
    return owner, name, "" if version == "tip" else version, "/".join(rest[1:] if rest[:1] == ["files"] else rest)


def read_mesh_file(path: Path, files: SceneFiles) -> Content:
    """Reads a glTF, OBJ, PLY, STL or COLLADA file.

    Raises:
        ValueError: the file is malformed or has a different format.
        WorldError: the file cannot be read, or has too many triangles.
    """
    kind, data = kind_of_file(path), files.read(path)
    if kind == "glTF":
        return read_gltf(data, replace(files, root=path))
    if kind not in _MESHES:
        raise ValueError(f"a mesh of format {kind or 'unknown'} is not read; convert it to glTF, OBJ, COLLADA or STL")
    return _MESHES[kind](data, path, files)


@dataclass
class Library:
    """Files of a world."""

    files: SceneFiles
    _contents: dict[Path, Content | None] = field(default_factory=dict)

    @property
    def folders(self) -> tuple[Path, ...]:
        """Folders in which `model://` and `package://` names are searched, in this order."""
        root = self.files.root.parent
        return (*self.files.scene.limits.models, root, root / "models")

    def find(self, uri: str, folder: Path) -> Path:
        """Returns the path of a URI, which may not exist; a relative path is also searched in `folders`, as in Gazebo.

        Args:
            uri: relative path, or `file://`, `model://` or `package://` URI.
            folder: folder of the file that contains the reference.
        """
        if uri.startswith(REMOTE):
            return next((place for place in self._copies(uri) if place.exists()), Path(uri))
        is_named = uri.startswith(NAMED)
        path = uri.partition("://")[2].strip("/") if is_named else uri
        places = [place_of(each, path) for each in (*(() if is_named else (folder,)), *self.folders)]
        return next((place for place in places if place.exists()), places[-1 if is_named else 0])

    def _copies(self, uri: str) -> Iterator[Path]:
        """Yields the places of a copy of a model of Fuel: a folder with its name, or in the cache of Gazebo."""
        owner, name, version, rest = fuel_name(uri)
        for folder in self.folders:
            for plain in dict.fromkeys((name, name.lower(), name.lower().replace(" ", "_"))):
                yield place_of(folder, quote(f"{plain}/{rest}"))
            for cache in (folder, *(folder / host for host in _FUEL_HOSTS)):
                versions = place_of(cache, quote(f"{owner.lower()}/models/{name.lower()}"))
                stored = sorted((each.name for each in versions.glob("[0-9]*")), key=int, reverse=True)
                yield from (place_of(versions / number, quote(rest)) for number in ([version] if version else stored))

    def locate(self, uri: str, folder: Path, user: str) -> Path | None:
        """Returns the file or folder of a URI, or records that it is missing and returns `None`; see `find`.

        Args:
            uri: URI.
            folder: folder of the file that contains the reference.
            user: node that refers to it, for the message.
        """
        place = self.find(uri, folder)
        if uri.startswith(REMOTE) and not place.exists():
            reason = "files on the network (download them into a folder, and give it with --model-dir DIR)"
            self.files.add_fault(reason, uri, user)
        elif uri.startswith(NAMED) and not place.exists():
            searched = ", ".join(str(folder) for folder in self.folders)
            self.files.add_fault(
                f"files missing in {searched} (give the folder that contains them with --model-dir DIR)", uri, user
            )
        elif (place.is_dir() and self.files.readable.encloses(str(place))) or self.files.is_usable(place, user):
            return place
        return None

    def place_mesh(
        self, path: str, mesh: Path, to_world: Floats, is_collider: bool, surface: Surface | None, submesh: str = ""
    ) -> None:
        """Adds a mesh file to the scene; a malformed file adds a note.

        Args:
            path: path of the node.
            mesh: file of the mesh.
            to_world: (4, 4) transform of the node, metres.
            is_collider: whether the mesh is for collision only.
            surface: appearance that replaces the materials of the file; `None` keeps them.
            submesh: name of the only shape to take; empty takes all.
        """
        content = self._content(mesh, path)
        if content is None:
            return
        shapes = [shape for shape in content.shapes if submesh in ("", shape.path.rpartition("/")[2])]
        if surface is not None:
            shapes = [
                replace(shape, pieces=tuple(replace(p, surface=surface) for p in shape.pieces)) for shape in shapes
            ]
        up = content.up if kind_of_file(mesh) == "glTF" else "z"  # Gazebo and RViz ignore up_axis of COLLADA
        matrix = np.asarray(to_world @ to_metres(content.metres_per_unit or 1.0, up or "z"))
        place_content(
            self.files.scene, path, content=replace(content, shapes=shapes), to_world=matrix, is_collider=is_collider
        )

    def place_solid(
        self, path: str, kind: str, solid: Polygons | None, to_world: Floats, is_collider: bool, surface: Surface | None
    ) -> None:
        """Adds a solid to the scene; one that is not supported adds a note.

        Args:
            path: path of the node.
            kind: name of the geometry in the file.
            solid: polygons, metres; `None` if the geometry is not supported.
            to_world: (4, 4) transform of the node, metres.
            is_collider: whether the solid is for collision only.
            surface: appearance; `None` is grey.
        """
        scene = self.files.scene
        if solid is None:
            scene.notes.append(f"{path}: geometry <{kind}> is not supported, skipped")
            return
        piece = solid_piece(solid, surface or Surface(colour=(0.4, 0.4, 0.4)))
        scene.place(path, [piece], to_world, is_collider)

    def _content(self, mesh: Path, user: str) -> Content | None:
        if mesh not in self._contents:
            try:
                self._contents[mesh] = read_mesh_file(mesh, self.files)
            except BROKEN as error:
                self._contents[mesh] = None
                self.files.scene.notes.append(f"{user}: mesh {mesh.name} skipped, {error}")
        return self._contents[mesh]


def _recoloured(shape: ShapeNode, surface: Surface) -> ShapeNode:
    return replace(shape, pieces=tuple(replace(piece, surface=surface, tints=None) for piece in shape.pieces))


def model_file(folder: Path, files: SceneFiles) -> Path | None:
    """Returns the SDF file of a Gazebo model folder: the one of the highest version in `model.config`.

    If `model.config` is malformed or does not exist, returns `model.sdf`, or else the first SDF file of the folder.
    """
    config = folder / "model.config"
    usual = next((place for place in (folder / "model.sdf", *sorted(folder.glob("*.sdf"))) if place.is_file()), None)
    if not config.is_file():
        return usual
    try:
        root = files.read_xml(config)
        entries = [(_version(entry.get("version", "0")), (entry.text or "").strip()) for entry in root.iter("sdf")]
    except ValueError as error:
        if usual is not None:
            files.scene.notes.append(f"{error}; {usual.name} is read")
        return usual
    return place_of(folder, max(entries)[1]) if entries else folder / (text_of(root, "sdf") or "model.sdf")


def _version(text: str) -> tuple[int, ...]:
    return tuple(int(part) for part in text.split(".") if part.isdigit())
