"""Places the geometry of SDFormat visuals and collisions: meshes and solids, with their materials."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING

import numpy as np

from factory.scenes.formats.library import Library
from factory.scenes.formats.poses import numbers
from factory.scenes.formats.shapes import display_colour
from factory.scenes.formats.xml_text import text_of
from factory.scenes.importer.model import Surface
from factory.scenes.importer.solids import Polygons, box, capsule, cylinder, plane, sphere
from schemas.support.numpy_types import Floats

if TYPE_CHECKING:
    from xml.etree.ElementTree import Element

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
    }
)
"""Colours of the materials `Gazebo/...`, lower case."""


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
            library.place_mesh(name, mesh, np.asarray(to_world @ scale), is_collider, surface, submesh)
        return
    library.place_solid(name, kind.tag, _solid(kind), to_world, is_collider, surface)


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
    red, green, blue, alpha = _rgba(material.findtext("diffuse"), _script(material))
    glow = display_colour(*_rgba(material.findtext("emissive"), (0.0, 0.0, 0.0))[:3])
    colour = display_colour(red, green, blue)
    surface = Surface(
        *(colour, "", colour),
        opacity=alpha * opacity,
        emits=max(glow) > 0.05,
        emission=glow,
        name=(material.findtext("script/name") or "").strip(),
    )
    albedo = material.findtext("pbr/metal/albedo_map") or material.findtext("pbr/specular/albedo_map")
    if albedo:
        image = library.find(albedo.strip(), path.parent)
        white = replace(surface, colour=(1.0, 1.0, 1.0)) if material.find("diffuse") is None else surface
        return library.files.textured(white, image.parent, image.name, name)
    is_empty = not any(material.find(tag) is not None for tag in ("diffuse", "script", "emissive", "ambient"))
    return None if is_empty else surface


def _script(material: Element) -> tuple[float, float, float]:
    name = (material.findtext("script/name") or "").strip().lower().removeprefix("gazebo/")
    words = (colour for key, colour in _SCRIPTS.items() if name.startswith(key))
    return _SCRIPTS.get(name) or next(words, (0.7, 0.7, 0.7))


def _rgba(text: str | None, default: tuple[float, float, float]) -> tuple[float, float, float, float]:
    values = (text or "").split()
    red, green, blue, alpha = numbers(text, (*default, 1.0)) if len(values) != 3 else (*numbers(text, default), 1.0)
    return red, green, blue, alpha
