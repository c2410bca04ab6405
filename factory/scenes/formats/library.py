"""Finds and reads the files to which a world refers: models and meshes, by path, model:// or package:// name.

Reads each mesh once. Records missing files, so one error names all of them.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from urllib.parse import quote, unquote

import numpy as np

from factory.scenes.formats.collada import read_collada
from factory.scenes.formats.files import SceneFiles, place_of
from factory.scenes.formats.gltf import read_gltf
from factory.scenes.formats.meshes import read_ply, read_stl
from factory.scenes.formats.obj import read_obj
from factory.scenes.formats.ogre import OgreMaterial, read_materials
from factory.scenes.formats.shapes import BROKEN, Content, place_content, solid_piece, to_metres
from factory.scenes.formats.xml_text import text_of
from factory.scenes.importer.collect import Piece
from factory.scenes.importer.content import Surface
from factory.scenes.importer.solids import Polygons
from factory.scenes.stage_file import kind_of_file
from schemas.support.geometry import cross
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
    _unknown: set[str] = field(default_factory=set)
    _scripts: dict[Path, dict[str, OgreMaterial]] = field(default_factory=dict)

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
        own = _own_places(folder, path) if is_named else ()
        return next((place for place in (*places, *own) if place.exists()), places[-1 if is_named else 0])

    def find_material(self, name: str, uris: Sequence[str], folder: Path) -> tuple[OgreMaterial, Path] | None:
        """Returns the material of a script of Ogre and the script's file, or `None` if no script defines it.

        Args:
            name: name of the material.
            uris: URIs of scripts and of folders with scripts; `materials/scripts` of the model is searched, too.
            folder: folder of the file that refers to the material.
        """
        places = [self.find(uri, folder) for uri in uris]
        for place in dict.fromkeys((*places, folder / "materials" / "scripts")):
            files = sorted(place.glob("*.material")) if place.is_dir() else [place]
            for file in files:
                if file.suffix == ".material" and file.is_file() and name in self._materials(file):
                    return self._materials(file)[name], file
        return None

    def is_new(self, material: str) -> bool:
        """Returns whether an unknown material is met for the first time, so it is noted once."""
        is_new = material not in self._unknown
        self._unknown.add(material)
        return is_new

    def _materials(self, file: Path) -> dict[str, OgreMaterial]:
        if file not in self._scripts:
            self._scripts[file] = {}
            if self.files.readable.encloses(str(file)):
                try:
                    self._scripts[file] = read_materials(self.files.read(file).decode("utf-8-sig", errors="replace"))
                except ValueError as error:
                    self.files.scene.notes.append(f"{self.files.shown(file)}: {error}; its materials are not used")
        return self._scripts[file]

    def textured(self, surface: Surface, reference: str, folders: Iterable[Path], user: str) -> Surface:
        """Returns a surface with the texture that is found first in folders; see `SceneFiles.textured`."""
        places = [self.files.find_texture(folder, reference) for folder in folders]
        place = next((place for place in places if place.is_file()), places[0])
        return self.files.textured(surface, place.parent, place.name, user)

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
            shapes = [replace(each, pieces=tuple(_covered(p, surface) for p in each.pieces)) for each in shapes]
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
        surface = surface or Surface(colour=(0.4, 0.4, 0.4))
        piece = solid_piece(solid, surface)
        if surface.texture:
            piece = _covered(replace(piece, uvs=_projected(piece.triangles)), surface)
        scene.place(path, [piece], to_world, is_collider)

    def _content(self, mesh: Path, user: str) -> Content | None:
        if mesh not in self._contents:
            try:
                self._contents[mesh] = read_mesh_file(mesh, self.files)
            except BROKEN as error:
                self._contents[mesh] = None
                self.files.scene.notes.append(f"{user}: mesh {mesh.name} skipped, {error}")
        return self._contents[mesh]


def _own_places(folder: Path, path: str) -> Iterator[Path]:
    """Yields the place of a file of a model that names itself: its folder has its name, or a version of Fuel below."""
    name, _, rest = path.partition("/")
    for model in (folder, folder.parent, folder.parent.parent):
        if (model / "model.config").is_file() and _plain(unquote(name)) in (
            _plain(model.name),
            _plain(model.parent.name),
        ):
            yield place_of(model, rest)


def _plain(name: str) -> str:
    return name.lower().replace(" ", "_").replace("-", "_")


def _covered(piece: Piece, surface: Surface) -> Piece:
    """Returns a piece with another surface, whose transform of texture coordinates is applied."""
    if piece.uvs is None or surface.uv_affine is None:
        return replace(piece, surface=surface)
    rows = np.array(surface.uv_affine).reshape(2, 3)
    return replace(piece, uvs=np.asarray(piece.uvs @ rows[:, :2].T + rows[:, 2]), surface=surface)


def _projected(triangles: Floats) -> Floats:
    """Returns texture coordinates (T, 3, 2) of a solid: each face shows the texture once, projected along an axis."""
    corners = triangles.reshape(-1, 3)
    low, size = corners.min(axis=0), np.maximum(np.ptp(corners, axis=0), 1e-9)
    share = (triangles - low) / size
    normals = cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
    axis = np.abs(normals).argmax(axis=1)
    along, up = np.array([1, 0, 0])[axis], np.array([2, 2, 1])[axis]
    rows = np.arange(len(triangles))
    u, v = share[rows, :, along], share[rows, :, up]
    is_mirrored = (normals[rows, axis] > 0) == (axis == 1)
    return np.stack([np.where(is_mirrored[:, None], 1 - u, u), v], axis=2)


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
