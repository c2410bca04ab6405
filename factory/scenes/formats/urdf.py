"""Reads URDF: links with their visuals and collisions, connected by joints at position zero.

Limits, dynamics, transmissions and Gazebo extensions are ignored. xacro macros are not expanded; those that are left in
a link are ignored.
"""

from __future__ import annotations

import re
from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from factory.scenes.formats.files import SceneFiles
from factory.scenes.formats.library import Library
from factory.scenes.formats.poses import numbers, pose_matrix
from factory.scenes.formats.shapes import BROKEN, ROOT, Names, display_colour
from factory.scenes.importer.content import Surface
from factory.scenes.importer.solids import Polygons, box, capsule, cylinder, sphere
from schemas.support.numpy_types import Floats
from schemas.support.shell import quoted

if TYPE_CHECKING:
    from xml.etree.ElementTree import Element

_MOVABLE = ("revolute", "continuous", "prismatic")
_READER_VERSION = "urdf 2"
"""Incremented when the reader returns other parts for the same file."""


def read_urdf(path: Path, files: SceneFiles) -> None:
    """Reads a robot or an environment into the scene of `files`.

    Args:
        path: .urdf file.
        files: files of the import.

    Raises:
        ValueError: the file is malformed, or contains xacro macros.
        WorldError: files are missing; the message names all.
    """
    robot = files.read_xml(path)
    _require_expanded(robot, path, files)
    files.scene.notes += _unknown_elements(robot)
    library, names = Library(files), Names()
    materials = {str(element.get("name")): element for element in robot.iter("material") if len(element)}
    places = _link_places(robot)
    parents, paths = _parents_of_parts(robot, places), {"": ROOT}
    carriers, order = set(parents.values()), {name: number for number, name in enumerate(places)}
    files.scene.reader_version = _READER_VERSION
    for link in sorted(robot.findall("link"), key=lambda link: order[str(link.get("name"))]):
        name = str(link.get("name"))
        link_path = paths[name] = names.path(paths[parents.get(name, "")], link.get("name"), "link")
        if name not in parents:
            files.scene.models.add(link_path)
            if name in carriers:
                files.scene.articulated.add(link_path)
        for kind in ("visual", "collision"):
            for shape in link.findall(kind):
                shape_path = names.path(link_path, shape.get("name"), kind)
                try:
                    surface = None if kind == "collision" else _surface(library, shape, materials, path, shape_path)
                    place = np.asarray(places[name] @ _origin(shape))
                    _place_geometry(library, shape, path=path, name=shape_path, to_world=place, surface=surface)
                except BROKEN as error:
                    files.scene.notes.append(f"{shape_path}: skipped, {error}")
    files.require_all()


_OF_LINKS = frozenset({"visual", "collision", "inertial", "contact", "gazebo", "sensor", "self_collision_checking"})
_OF_SHAPES = frozenset({"origin", "geometry", "material", "name", "verbose", "contact_coefficients"})


def _unknown_elements(robot: Element) -> list[str]:
    """Returns a note on the elements of links and shapes that URDF does not define, or nothing."""
    links = robot.findall("link")
    below = [child for link in links for child in link if child.tag not in _OF_LINKS]
    shapes = (shape for link in links for shape in link if shape.tag in ("visual", "collision"))
    below += [child for shape in shapes for child in shape if child.tag not in _OF_SHAPES]
    names = sorted({f"<{child.tag}>" for child in below if not _is_xacro(child)})
    shown = ", ".join(name[:40] for name in names[:5]) + (", ..." if len(names) > 5 else "")
    return [f"elements of links that URDF does not define are ignored: {shown}"] if names else []


_SILENT = ("arg", "property")
"""Elements of xacro that define values only; without a use of the values, they have no effect."""


def _require_expanded(robot: Element, path: Path, files: SceneFiles) -> None:
    """Checks that the file needs no xacro. Elements of xacro that are left in a link or joint add a note.

    Raises:
        ValueError: it defines, includes or uses macros, or an attribute contains an expression; the message names the
            line, and the command that expands the file.
    """
    text = files.read(path).decode("utf-8-sig", errors="replace")
    for number, line in enumerate(_COMMENT.sub(_blank, text).splitlines(), 1):
        expression = _EXPRESSION.search(line)
        if expression:
            raise ValueError(f"line {number} contains the xacro expression {expression[0]}; {_expand(path)}")
    above = {child: parent for parent in robot.iter() for child in parent}
    for element in robot.iter():
        if not _is_xacro(element):
            continue
        tag = f"xacro:{_local(element)}"
        number = next((k for k, line in enumerate(text.splitlines(), 1) if f"<{tag}" in line), 0)
        if _local(element) not in _SILENT and not _has_parent(element, above, ("link", "joint")):
            raise ValueError(f"line {number} contains <{tag}>, a macro of xacro; {_expand(path)}")
        files.scene.notes.append(f"line {number}: <{tag}> is not expanded, ignored")


_COMMENT = re.compile(r"<!--.*?-->", re.DOTALL)
_EXPRESSION = re.compile(r"\$\{[^}]*\}|\$\((?:arg|find|env|optenv|eval)\b[^)]*\)")


def _blank(found: re.Match[str]) -> str:
    return "\n" * found[0].count("\n")


def _is_xacro(element: Element) -> bool:
    space = str(element.tag).rpartition("}")[0]
    return space.endswith(("/xacro", "{xacro"))


def _local(element: Element) -> str:
    return str(element.tag).rpartition("}")[2]


def _has_parent(element: Element, above: dict[Element, Element], tags: tuple[str, ...]) -> bool:
    while element in above:
        element = above[element]
        if element.tag in tags:
            return True
    return False


def _expand(path: Path) -> str:
    """Returns the command that expands a file into another one beside it."""
    plain = path.with_suffix("") if path.suffix == ".xacro" else path
    target = plain.with_name(f"{plain.stem}.urdf") if plain != path else path.with_name(f"{path.stem}_expanded.urdf")
    return f"expand it first: xacro {quoted(path)} -o {quoted(target)}"


def _origin(element: Element) -> Floats:
    origin = element.find("origin")
    values = {} if origin is None else origin.attrib
    return pose_matrix(numbers(values.get("xyz"), (0, 0, 0)), numbers(values.get("rpy"), (0, 0, 0)))


def _link_places(robot: Element) -> dict[str, Floats]:
    """Returns the transform (4, 4) link -> robot of each link, parents before children.

    Raises:
        ValueError: a joint names no link, or joints form a loop.
    """
    joints = {_end(joint, "child"): joint for joint in robot.findall("joint")}
    places: dict[str, Floats] = {}
    for link in robot.findall("link"):
        chain = [str(link.get("name"))]
        while chain[-1] in joints and chain[-1] not in places:
            parent = _end(joints[chain[-1]], "parent")
            if parent in chain:
                raise ValueError(f"joints form a loop at link {parent}")
            chain.append(parent)
        for name in reversed(chain):
            if name not in places:
                joint = joints.get(name)
                base = np.eye(4) if joint is None else np.asarray(places[_end(joint, "parent")] @ _origin(joint))
                places[name] = base
    return places


def _parents_of_parts(robot: Element, places: Iterable[str]) -> dict[str, str]:
    """Returns the parent of each link that is a part of an object, such as a drawer, a door or its handle.

    A link is a part if a movable joint connects it with a link that has a shape or is a part, or if its parent is a
    part. Other links that are fixed to a link are objects, such as an oven in a cabinet.

    Args:
        robot: root element.
        places: names of the links, parents before children.
    """
    shaped = {str(link.get("name")) for link in robot.findall("link") if link.find("visual") is not None}
    joints = {_end(joint, "child"): joint for joint in robot.findall("joint")}
    parents: dict[str, str] = {}
    for name in places:
        joint = joints.get(name)
        parent = "" if joint is None else _end(joint, "parent")
        if parent in parents or (joint is not None and joint.get("type") in _MOVABLE and parent in shaped):
            parents[name] = parent
    return parents


def _end(joint: Element, which: str) -> str:
    end = joint.find(which)
    if end is None or not end.get("link"):
        raise ValueError(f"joint {joint.get('name')} has no {which} link")
    return str(end.get("link"))


def _place_geometry(
    library: Library, shape: Element, path: Path, name: str, to_world: Floats, surface: Surface | None
) -> None:
    geometry = shape.find("geometry")
    if geometry is None or not len(geometry):
        return
    kind, is_collider = geometry[0], shape.tag == "collision"
    if kind.tag == "mesh":
        mesh = library.locate(str(kind.get("filename") or ""), path.parent, name)
        scale = np.diag([*numbers(kind.get("scale"), (1, 1, 1)), 1.0])
        if mesh is not None:
            library.place_mesh(
                name, mesh, to_world=np.asarray(to_world @ scale), is_collider=is_collider, surface=surface
            )
        return
    library.place_solid(name, kind.tag, solid=_solid(kind), to_world=to_world, is_collider=is_collider, surface=surface)


def _solid(kind: Element) -> Polygons | None:
    radius, length = (numbers(kind.get(key), (1.0,))[0] for key in ("radius", "length"))
    if kind.tag == "box":
        x, y, z = numbers(kind.get("size"), (1, 1, 1))
        return box(x / 2, y / 2, z / 2)
    solids = {
        "sphere": lambda: sphere(radius),
        "cylinder": lambda: cylinder(radius, radius, length / 2),
        "capsule": lambda: capsule(radius, radius, length / 2),
    }
    return solids[kind.tag]() if kind.tag in solids else None


def _surface(library: Library, shape: Element, materials: dict[str, Element], path: Path, name: str) -> Surface | None:
    """Returns the material of a visual, or `None` if it has none."""
    shape_material = shape.find("material")
    material = (
        None
        if shape_material is None
        else (shape_material if len(shape_material) else materials.get(str(shape_material.get("name"))))
    )
    if material is None:
        return None
    rgba, texture = material.find("color"), material.find("texture")
    red, green, blue, alpha = numbers(None if rgba is None else rgba.get("rgba"), (1.0, 1.0, 1.0, 1.0))
    colour = display_colour(red, green, blue)
    surface = Surface(colour, "", colour, opacity=alpha, name=str(material.get("name") or ""))
    if texture is None or not texture.get("filename"):
        return surface if rgba is not None else None
    image = library.find(str(texture.get("filename")), path.parent)
    return library.files.textured(surface, image.parent, image.name, name)
