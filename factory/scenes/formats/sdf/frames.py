"""Poses of SDFormat: `<pose>` with its attributes, relative to a named frame of a model or world. Pure functions."""

from __future__ import annotations

from math import radians
from typing import TYPE_CHECKING

import numpy as np

from factory.scenes.formats.poses import numbers, pose_matrix, quaternion_matrix
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
