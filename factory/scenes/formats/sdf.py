"""Reads SDFormat worlds and models (Gazebo): includes, nested models, poses, links, visuals and collisions.

Joints, physics, sensors and plugins are ignored; models are in their initial pose. Lights are counted.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field, replace
from math import radians
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING

import numpy as np

from factory.scenes.formats.files import SceneFiles
from factory.scenes.formats.library import NAMED, REMOTE, Library, fuel_name, model_file
from factory.scenes.formats.ogre import OgreMaterial
from factory.scenes.formats.poses import numbers, pose_matrix, quaternion_matrix
from factory.scenes.formats.shapes import BROKEN, LIGHTS_NOTE, ROOT, Names, display_colour, solid_piece
from factory.scenes.formats.xml_text import text_of
from factory.scenes.importer.content import Surface
from factory.scenes.importer.solids import Polygons, box, capsule, cylinder, plane, sphere
from factory.scenes.navigation.floor import SUNK_M, lowest_level
from schemas.errors import WorldError
from schemas.support.numpy_types import Floats

if TYPE_CHECKING:
    from xml.etree.ElementTree import Element


_FRAMED = ("link", "model", "include", "frame", "joint")


def read_pose(element: Element) -> Floats:
    """Returns the transform (4, 4) of the `<pose>` of an element; identity without one.

    Raises:
        ValueError: the numbers are not valid.
    """
    pose = element.find("pose")
    if pose is None:
        return np.eye(4)
    if pose.get("rotation_format") == "quat_xyzw":
        *xyz, qx, qy, qz, qw = numbers(pose.text, (0, 0, 0, 0, 0, 0, 1))
        matrix = quaternion_matrix((qw, qx, qy, qz))
        matrix[:3, 3] = xyz
        return matrix
    x, y, z, *angles = numbers(pose.text, (0,) * 6)
    is_degrees = pose.get("degrees") in ("true", "1")
    return pose_matrix((x, y, z), [radians(angle) if is_degrees else angle for angle in angles])


class Frames:
    """Named frames of one model or world, relative to it."""

    def __init__(self, scope: Element) -> None:
        """Collects the frames of a `<model>` or `<world>` element."""
        framed = [child for child in scope if child.tag in _FRAMED]
        self._elements = {child.get("name") or (child.findtext("name") or "").strip(): child for child in framed}
        self._known: dict[str, Floats] = {"__model__": np.eye(4), "world": np.eye(4)}

    def pose_of(self, element: Element, base: Floats | None = None) -> Floats:
        """Returns the transform (4, 4) element -> model of an element of the model.

        Args:
            element: element with an optional `<pose>`.
            base: frame of a pose without `relative_to`; the model when `None`.

        Raises:
            ValueError: `relative_to` names no frame, or leads back to the element.
        """
        pose = element.find("pose")
        name = "" if pose is None else (pose.get("relative_to") or "")
        if name:
            base = self.frame(name)
        elif element.get("attached_to") or element.tag == "joint":
            base = self.frame(element.get("attached_to") or (element.findtext("child") or "").strip())
        return np.asarray((np.eye(4) if base is None else base) @ read_pose(element))

    def frame(self, name: str) -> Floats:
        """Returns the transform (4, 4) of a named frame; see `pose_of` for the errors."""
        first = name.partition("::")[0]
        if first not in self._known:
            if first not in self._elements:
                raise ValueError(f"pose relative to {name!r}, which is not a frame of the model")
            element = self._elements.pop(first)  # removed, so a circular reference is an error
            self._known[first] = self.pose_of(element)
        return self._known[first]


_SCRIPTS = MappingProxyType(
    {
        "grey": (0.7, 0.7, 0.7),
        "darkgrey": (0.175, 0.175, 0.175),
        "white": (1.0, 1.0, 1.0),
        "flatblack": (0.1, 0.1, 0.1),
        "black": (0.0, 0.0, 0.0),
        "red": (1.0, 0.0, 0.0),
        "green": (0.0, 1.0, 0.0),
        "blue": (0.0, 0.0, 1.0),
        "skyblue": (0.13, 0.44, 0.7),
        "yellow": (1.0, 1.0, 0.0),
        "orange": (1.0, 0.5088, 0.0468),
        "purple": (1.0, 0.0, 1.0),
        "turquoise": (0.0, 1.0, 1.0),
        "gold": (0.8, 0.65, 0.12),
        "wood": (0.6, 0.45, 0.3),
        "residential": (0.7, 0.7, 0.7),
        "lightwood": (0.7, 0.55, 0.4),
        "paintedwall": (0.78, 0.74, 0.68),
        "ceilingtiled": (0.85, 0.85, 0.83),
        "grass": (0.25, 0.4, 0.18),
        "bricks": (0.6, 0.33, 0.27),
        "rockwall": (0.5, 0.47, 0.43),
        "road": (0.3, 0.3, 0.3),
        "asphalt": (0.3, 0.3, 0.3),
        "motorway": (0.3, 0.3, 0.3),
        "pedestrian": (0.55, 0.53, 0.5),
        "runway": (0.35, 0.35, 0.35),
        "zincyellow": (0.9742, 0.94, 0.0),
        "darkyellow": (0.7, 0.7, 0.0),
        "darkorange": (1.0, 0.2645, 0.0),
        "indigo": (0.33, 0.0, 0.5),
        "shell": (0.87, 0.82, 0.72),
        "chrome": (0.75, 0.75, 0.75),
        "whiteglow": (1.0, 1.0, 1.0),
        "cloudysky": (0.7, 0.78, 0.87),
    }
)
"""Colours of the materials `Gazebo/...`, lower case; of those with a texture, its mean by eye."""


def place_geometry(library: Library, shape: Element, path: Path, name: str, to_world: Floats) -> None:
    """Adds a `<visual>` or `<collision>` to the scene.

    Args:
        library: files of the world.
        shape: the element.
        path: file that contains it.
        name: path of the shape in the scene.
        to_world: (4, 4) transform of the shape, metres.

    Raises:
        ValueError: a number is not valid.
    """
    is_collider = shape.tag == "collision"
    geometry = shape.find("geometry")
    kind = None if geometry is None or not len(geometry) else geometry[0]
    if kind is None or kind.tag == "empty" or (is_collider and kind.tag == "plane"):
        return  # a plane is a floor, and the floor has no collider
    surface = None if is_collider else _surface(library, shape, path, name)
    if kind.tag == "mesh":
        mesh = library.locate(text_of(kind, "uri") or text_of(kind, "filename"), path.parent, name)
        scale = np.diag([*numbers(kind.findtext("scale"), (1, 1, 1)), 1.0])
        if mesh is not None:
            submesh = kind.findtext("submesh/name", "").strip()
            library.place_mesh(
                name,
                mesh,
                to_world=np.asarray(to_world @ scale),
                is_collider=is_collider,
                surface=surface,
                submesh=submesh,
            )
        return
    library.place_solid(name, kind.tag, solid=_solid(kind), to_world=to_world, is_collider=is_collider, surface=surface)


def _solid(kind: Element) -> Polygons | None:
    """Returns the polygons of a solid, metres, or `None` for other geometry."""
    radius, length = (numbers(kind.findtext(tag), (1.0,))[0] for tag in ("radius", "length"))
    if kind.tag == "box":
        x, y, z = numbers(kind.findtext("size"), (1, 1, 1))
        return box(x / 2, y / 2, z / 2)
    if kind.tag == "plane":
        return _plane(kind)
    if kind.tag == "ellipsoid":
        points, counts, indices = sphere(1.0)
        return points * numbers(kind.findtext("radii"), (1, 1, 1)), counts, indices
    solids = {
        "sphere": lambda: sphere(radius),
        "cylinder": lambda: cylinder(radius, radius, length / 2),
        "cone": lambda: cylinder(radius, 0.0, length / 2),
        "capsule": lambda: capsule(radius, radius, length / 2),
    }
    return solids[kind.tag]() if kind.tag in solids else None


def _plane(kind: Element) -> Polygons:
    normal = np.array(numbers(kind.findtext("normal"), (0, 0, 1)))
    size = numbers(kind.findtext("size"), (1, 1))
    points, counts, indices = plane(size[0] / 2, size[1] / 2)
    length = float(np.linalg.norm(normal))
    if length < 1e-9:
        raise ValueError("the normal of a plane is zero")
    z = normal / length
    x = np.cross([0.0, 1.0, 0.0] if abs(z[1]) < 0.9 else [0.0, 0.0, 1.0], z)
    x /= np.linalg.norm(x)
    return points @ np.stack([x, np.cross(z, x), z]), counts, indices


def _surface(library: Library, shape: Element, path: Path, name: str) -> Surface | None:
    """Returns the material of a visual, or `None` if it has none."""
    material = shape.find("material")
    opacity = 1.0 - numbers(shape.findtext("transparency"), (0.0,))[0]
    if material is None:
        return None
    scripted, base = _scripted(library, material, path, name)
    red, green, blue, alpha = _rgba(material.findtext("diffuse"), (0.7, 0.7, 0.7))
    surface = replace(scripted, opacity=scripted.opacity * opacity)
    if material.find("diffuse") is not None:
        colour = display_colour(red, green, blue)
        surface = replace(surface, colour=colour, fallback=colour, opacity=alpha * opacity)
    if material.find("emissive") is not None:
        glow = display_colour(*_rgba(material.findtext("emissive"), (0.0, 0.0, 0.0))[:3])
        surface = replace(surface, emits=max(glow) > 0.05, emission=glow)
    albedo = material.findtext("pbr/metal/albedo_map") or material.findtext("pbr/specular/albedo_map")
    if albedo:
        image = library.find(albedo.strip(), path.parent)
        white = replace(surface, colour=(1.0, 1.0, 1.0)) if material.find("diffuse") is None else surface
        return library.textured(white, image.name, (image.parent, path.parent), name)
    if base is not None and base[0].texture:
        script, file = base
        uris = [library.find(uri, path.parent) for uri in _uris(material)]
        folders = [folder for folder in uris if folder.is_dir()]
        folders += [file.parent, file.parent.parent / "textures", path.parent]
        return script.textured(library.textured(surface, script.texture, folders, name))
    is_empty = not any(material.find(tag) is not None for tag in ("diffuse", "script", "emissive", "ambient"))
    return None if is_empty else surface


def _uris(material: Element) -> list[str]:
    return [(uri.text or "").strip() for uri in material.findall("script/uri") if (uri.text or "").strip()]


def _scripted(
    library: Library, material: Element, path: Path, user: str
) -> tuple[Surface, tuple[OgreMaterial, Path] | None]:
    """Returns the colours of the script of a material, or gray; and the script's material and file, if it is found."""
    name = text_of(material, "script/name")
    found = library.find_material(name, _uris(material), path.parent) if name else None
    if found is not None:
        return found[0].surface(), found
    known = _gazebo_colour(name)
    if name and known is None and library.is_new(name):
        searched = ", ".join(_uris(material)) or "materials/scripts"
        library.files.scene.notes.append(
            f"{user}: material {name} of {library.files.shown(path)} is defined neither in {searched} nor by Gazebo, "
            "all that use it are shown in gray"
        )
    colour = display_colour(*(known or (0.7, 0.7, 0.7)))
    return Surface(colour, "", colour, name=name), None


def _gazebo_colour(name: str) -> tuple[float, float, float] | None:
    """Returns the sRGB colour of a material of Gazebo, such as `Gazebo/Red`, or `None`."""
    plain = name.lower().removeprefix("gazebo/")
    if plain in _SCRIPTS or plain == name.lower():
        return _SCRIPTS.get(plain)
    return next((colour for key, colour in _SCRIPTS.items() if plain.startswith(key)), None)


def _rgba(text: str | None, default: tuple[float, float, float]) -> tuple[float, float, float, float]:
    values = (text or "").split()
    red, green, blue, alpha = numbers(text, (*default, 1.0)) if len(values) != 3 else (*numbers(text, default), 1.0)
    return red, green, blue, alpha


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
    grounds: dict[float, tuple[str, str, Floats]] = field(default_factory=dict)
    """Path, URI and transform (4, 4) of the ground planes of Gazebo that are not in a searched folder, by height."""

    @property
    def files(self) -> SceneFiles:
        return self.library.files

    def parsed(self, path: Path) -> Element:
        if path not in self.documents:
            self.documents[path] = self.files.read_xml(path)
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
    _read_scope(reader, scopes[0], path=path, parent=ROOT, here=np.eye(4), above=(path,))
    files.require_all()
    _place_grounds(reader)
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
                _read_include(reader, child, path=path, parent=parent, place=place, above=above)
            elif child.tag == "model":
                _read_model(reader, child, path=path, named=(parent, child.get("name")), place=place, above=above)
            else:
                _read_link(reader, child, path=path, parent=parent, poses=(frames, here, place))
        except BROKEN as error:
            reader.files.scene.notes.append(f"{parent}/{child.get('name') or child.tag}: skipped, {error}")


def _read_model(
    reader: _Reader, model: Element, path: Path, named: tuple[str, str | None], place: Floats, above: tuple[Path, ...]
) -> None:
    model_path = reader.names.path(*named, "model")
    nested = sum(child.tag in _MODELS for child in model)
    (reader.files.scene.groups if nested > 1 else reader.files.scene.models).add(model_path)
    _read_scope(reader, model, path=path, parent=model_path, here=place, above=above)


def _read_include(
    reader: _Reader, include: Element, path: Path, parent: str, place: Floats, above: tuple[Path, ...]
) -> None:
    reader.includes += 1
    if reader.includes > _MOST_INCLUDES:
        raise WorldError(f"{reader.files.root.name} includes more than {_MOST_INCLUDES} models; split the world")
    uri = text_of(include, "uri")
    if _is_built_in(reader, include, uri, path=path, parent=parent, place=place):
        return
    location = reader.library.locate(uri, path.parent, parent)
    if location is not None and location.is_dir():
        folder, location = location, model_file(location, reader.files)
        if location is None or not reader.files.is_usable(location, parent):
            reader.files.add_fault("folders without an SDF file", folder, parent)
            return
    if location is None:
        return
    if location in above:
        raise ValueError(f"{uri} includes itself")
    root = reader.parsed(location)
    model = root if root.tag == "model" else root.find("model")
    if model is None and root.find("light") is not None:
        reader.counts[LIGHTS_NOTE] += 1
        return
    if model is None:
        raise ValueError(f"{uri} has no <model>")
    with_own = place if include.find("pose") is not None else np.asarray(place @ read_pose(model))
    if include.find("placement_frame") is not None:
        with_own = np.asarray(with_own @ np.linalg.inv(Frames(model).frame(text_of(include, "placement_frame"))))
    name = text_of(include, "name") or model.get("name")
    _read_model(reader, model, path=location, named=(parent, name), place=with_own, above=(*above, location))


def _is_built_in(reader: _Reader, include: Element, uri: str, path: Path, parent: str, place: Floats) -> bool:
    """Returns whether a model is part of Gazebo, and adds it; a copy in a searched folder has precedence."""
    name = fuel_name(uri)[1].lower().replace(" ", "_").replace("-", "_")
    if name not in ("sun", "ground_plane") or not uri.startswith((*NAMED, *REMOTE)):
        return False
    if reader.library.find(uri, path.parent).exists():
        return False
    if name == "sun":
        reader.counts[LIGHTS_NOTE] += 1
    else:
        plane_path = reader.names.path(parent, text_of(include, "name") or name, name)
        reader.grounds.setdefault(round(float(place[2, 3]), 3), (plane_path, uri, place))
    return True


_GROUND_M = 100.0


def _place_grounds(reader: _Reader) -> None:
    """Adds the built-in ground planes, after all models."""
    scene = reader.files.scene
    shown = [part.triangles for part in scene.parts if not part.is_collider]
    for path, uri, place in reader.grounds.values():
        scene.notes.append(f"{path}: {uri} is not in a searched folder; taken as a plane of {_GROUND_M:g} m")
        sunk = np.array(place)
        lowest = lowest_level(np.concatenate(shown), float(place[2, 3]), SUNK_M)[0] if shown else None
        if lowest is not None:
            sunk[2, 3] = min(float(place[2, 3]), lowest - SUNK_M)
        piece = solid_piece(plane(_GROUND_M / 2, _GROUND_M / 2), Surface(*(_GROUND, "", _GROUND)))
        scene.place(path, [piece], sunk)


_GROUND = display_colour(*_SCRIPTS["grey"])


def _read_link(reader: _Reader, link: Element, path: Path, parent: str, poses: tuple[Frames, Floats, Floats]) -> None:
    frames, model, place = poses
    link_path = reader.names.path(parent, link.get("name"), "link")
    reader.counts[LIGHTS_NOTE] += len(link.findall("light"))
    base = np.asarray(np.linalg.inv(model) @ place)
    for kind in ("visual", "collision"):
        for shape in link.findall(kind):
            shape_path = reader.names.path(link_path, shape.get("name"), kind)
            try:
                to_world = np.asarray(model @ frames.pose_of(shape, base))
                place_geometry(reader.library, shape, path=path, name=shape_path, to_world=to_world)
            except BROKEN as error:
                reader.files.scene.notes.append(f"{shape_path}: skipped, {error}")
