"""Reads SDFormat worlds and models (Gazebo): includes, nested models, links, visuals and collisions.

Joints, physics, sensors and plugins are ignored; models are in their initial pose. Lights are counted.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from factory.scenes.formats.files import SceneFiles
from factory.scenes.formats.library import Library, model_file
from factory.scenes.formats.sdf.frames import Frames, read_pose
from factory.scenes.formats.sdf.shapes import place_geometry
from factory.scenes.formats.shapes import BROKEN, LIGHTS_NOTE, ROOT, Names
from factory.scenes.formats.xml_text import parse_xml, text_of
from schemas.errors import WorldError
from schemas.support.numpy_types import Floats

if TYPE_CHECKING:
    from xml.etree.ElementTree import Element

_MOST_INCLUDES = 20_000
_MODELS = ("model", "include")
_NOT_KEPT = ("actor", "road", "population")


@dataclass
class _Reader:
    library: Library
    names: Names = field(default_factory=Names)
    documents: dict[Path, Element] = field(default_factory=dict)
    counts: Counter[str] = field(default_factory=Counter)
    includes: int = 0

    @property
    def files(self) -> SceneFiles:
        return self.library.files

    def parsed(self, path: Path) -> Element:
        if path not in self.documents:
            self.documents[path] = parse_xml(self.files.read(path))
        return self.documents[path]


def read_sdf(path: Path, files: SceneFiles) -> None:
    """Reads a world or model into the scene of `files`.

    Args:
        path: .sdf or .world file.
        files: files of the import.

    Raises:
        ValueError: the file is malformed.
        WorldError: files are missing; the message names all.
    """
    reader = _Reader(Library(files))
    root = reader.parsed(path)
    scopes = list(root.findall("world")) or ([root] if root.tag in ("sdf", "gazebo", "world") else [])
    if not scopes:
        raise ValueError(f"its root element is <{root.tag}>, not <sdf>")
    if len(scopes) > 1:
        files.scene.notes.append(f"{len(scopes)} worlds; the first is read: {scopes[0].get('name')}")
    _read_scope(reader, scopes[0], path, ROOT, np.eye(4), (path,))
    files.require_all()
    for what, count in (+reader.counts).items():
        files.scene.notes.append(f"{count} {what}")


def _read_scope(
    reader: _Reader, scope: Element, path: Path, parent: str, here: Floats, above: tuple[Path, ...]
) -> None:
    """Reads the models of a world, or the links and models of a model, whose frame is `here`."""
    frames = Frames(scope)
    for child in scope:
        reader.counts[LIGHTS_NOTE] += child.tag == "light"
        reader.counts["actors, roads or populations are omitted"] += child.tag in _NOT_KEPT
        if child.tag not in (*_MODELS, "link"):
            continue
        try:
            place = np.asarray(here @ frames.pose_of(child))
            if child.tag == "include":
                _read_include(reader, child, path, parent, place, above)
            elif child.tag == "model":
                _read_model(reader, child, path, (parent, child.get("name")), place, above)
            else:
                _read_link(reader, child, path, parent, (frames, here, place))
        except BROKEN as error:
            reader.files.scene.notes.append(f"{parent}/{child.get('name') or child.tag}: skipped, {error}")


def _read_model(
    reader: _Reader, model: Element, path: Path, named: tuple[str, str | None], place: Floats, above: tuple[Path, ...]
) -> None:
    own = reader.names.path(*named, "model")
    nested = sum(child.tag in _MODELS for child in model)
    (reader.files.scene.groups if nested > 1 else reader.files.scene.models).add(own)
    _read_scope(reader, model, path, own, place, above)


def _read_include(
    reader: _Reader, include: Element, path: Path, parent: str, place: Floats, above: tuple[Path, ...]
) -> None:
    reader.includes += 1
    if reader.includes > _MOST_INCLUDES:
        raise WorldError(f"{reader.files.root.name} includes more than {_MOST_INCLUDES} models; split the world")
    uri = text_of(include, "uri")
    found = reader.library.locate(uri, path.parent, parent)
    if found is not None and found.is_dir():
        folder, found = found, model_file(found, reader.files)
        if found is None or not reader.files.is_usable(found, parent):
            reader.files.add_fault("folders without an SDF file", folder, parent)
            return
    if found is None:
        return
    if found in above:
        raise ValueError(f"{uri} includes itself")
    root = reader.parsed(found)
    model = root if root.tag == "model" else root.find("model")
    if model is None:
        raise ValueError(f"{uri} has no <model>")
    with_own = place if include.find("pose") is not None else np.asarray(place @ read_pose(model))
    if include.find("placement_frame") is not None:
        with_own = np.asarray(with_own @ np.linalg.inv(Frames(model).frame(text_of(include, "placement_frame"))))
    name = text_of(include, "name") or model.get("name")
    _read_model(reader, model, found, (parent, name), with_own, (*above, found))


def _read_link(reader: _Reader, link: Element, path: Path, parent: str, poses: tuple[Frames, Floats, Floats]) -> None:
    frames, model, place = poses
    own = reader.names.path(parent, link.get("name"), "link")
    reader.counts[LIGHTS_NOTE] += len(link.findall("light"))
    base = np.asarray(np.linalg.inv(model) @ place)
    for kind in ("visual", "collision"):
        for shape in link.findall(kind):
            shape_path = reader.names.path(own, shape.get("name"), kind)
            try:
                to_world = np.asarray(model @ frames.pose_of(shape, base))
                place_geometry(reader.library, shape, path, shape_path, to_world)
            except BROKEN as error:
                reader.files.scene.notes.append(f"{shape_path}: skipped, {error}")
