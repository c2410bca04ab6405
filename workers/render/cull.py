"""View frustum culling: selects the parts of a scene in the camera's view, in order of their far corner, nearest first.

Pure geometry of bounding boxes. Does not render, and does not account for occlusion; the depth test does.
"""

from __future__ import annotations

import functools
import itertools
import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from schemas.config import CameraConfig
from schemas.scene import CompiledScene
from workers.geometry.camera import OpticalPose
from workers.render import Window

_MARGIN_PX = 2
"""Margin of a window around projected corners, pixels; OpenGL rounds corners to fractions of a pixel."""
_IS_HIGH = np.array(list(itertools.product((False, True), repeat=3)))
"""(8, 3) for each corner of a box, whether its x, y and z are the upper limits of the box."""
_DEPTH_MARGIN_M = 1e-3
"""Margin that is added to a largest depth, metres, because a depth image is rounded to float32."""

Edges = tuple[float, float, float, float]
"""Left, top, right and bottom edge of a part of the view, as x / depth and y / depth in the optical frame."""


@dataclass(frozen=True)
class PartBounds:
    """Bounding boxes of the parts along the world axes."""

    centre: NDArray[np.float64]
    """(P, 3) centres, metres."""
    half: NDArray[np.float64]
    """(P, 3) half extents, metres; negative infinity for a part without vertices, which is never visible."""

    @classmethod
    def of(cls, scene: CompiledScene) -> PartBounds:
        """Returns the bounding boxes of the parts of a scene."""
        count = len(scene.part_first)
        centre, half = np.zeros((count, 3)), np.full((count, 3), -np.inf)
        parts = np.flatnonzero(scene.part_count)
        if len(parts):
            rows = [np.arange(first, first + size) for first, size in zip(*_spans(scene, parts), strict=True)]
            corners, starts = scene.positions[np.concatenate(rows)], np.cumsum([0, *map(len, rows[:-1])])
            low, high = (reduce.reduceat(corners, starts).astype(np.float64) for reduce in (np.minimum, np.maximum))
            centre[parts], half[parts] = (low + high) / 2, (high - low) / 2
        return cls(centre, half)

    def corners(self, chosen: NDArray[np.intp]) -> NDArray[np.float64]:
        """Returns the corners (8, 3) of the box around parts with vertices, metres; (0, 3) around no part."""
        if not len(chosen):
            return np.empty((0, 3))
        centre, half = self.centre[chosen], self.half[chosen]
        return np.asarray(np.where(_IS_HIGH, (centre + half).max(axis=0), (centre - half).min(axis=0)))

    @functools.cached_property
    def facts(self) -> NDArray[np.float64]:
        """(7, P) centre, half extents and 1, the right operand of the product with `reach_of_planes`."""
        return np.ascontiguousarray(np.column_stack((self.centre, self.half, np.ones(len(self.centre)))).T)


def _spans(scene: CompiledScene, parts: NDArray[np.intp]) -> tuple[list[int], list[int]]:
    return scene.part_first[parts].tolist(), scene.part_count[parts].tolist()


def reach_of_planes(normals: NDArray[np.float64], offsets: NDArray[np.float64]) -> NDArray[np.float64]:
    """Returns a matrix (N, 7) for N planes.

    Its product with `PartBounds.facts` contains the height of the highest corner of each box above each plane.

    Args:
        normals: (N, 3) normals n of the planes n x + offset = 0, of any length.
        offsets: (N,) offsets of the planes.
    """
    return np.column_stack((normals, np.abs(normals), offsets))


def visible_parts(bounds: PartBounds, clip: NDArray[np.float64], eye: NDArray[np.float64]) -> NDArray[np.intp]:
    """Returns the indices of the parts whose box is at least partly in view, the one with the nearest far corner first.

    With this order a floor is drawn after the objects on it, so its hidden pixels are not shaded.

    Args:
        bounds: bounding boxes of the parts.
        clip: (4, 4) matrix from world to OpenGL clip space, for column vectors.
        eye: (3,) position of the camera in the world, metres.
    """
    w = clip[3]
    planes = np.concatenate((w + clip[:3], w - clip[:3]))  # left, bottom, near, right, top, far; inside is positive
    reach = reach_of_planes(planes[:, :3], planes[:, 3]) @ bounds.facts
    seen = np.flatnonzero(reach.min(axis=0) >= 0)
    far = np.abs(bounds.centre[seen] - eye) + bounds.half[seen]
    return seen[np.argsort(np.einsum("ij,ij->i", far, far), kind="stable")]


def may_reach(facts: NDArray[np.float64], optical: OpticalPose, edges: Edges, depth_m: float) -> NDArray[np.bool_]:
    """Returns whether each of the N boxes may have a point in a part of the view, up to a depth.

    Args:
        facts: (7, N) columns of `PartBounds.facts`.
        optical: pose of the camera.
        edges: edges of the part of the view.
        depth_m: largest depth, metres.
    """
    left, top, right, bottom = edges
    depth_m += _DEPTH_MARGIN_M
    ends = np.array(((0, 0, 0), (left, top, 1), (left, bottom, 1), (right, top, 1), (right, bottom, 1))) * depth_m
    corners = ends @ optical.rotation.T + optical.eye
    low, high = corners.min(axis=0)[:, None], corners.max(axis=0)[:, None]
    may = (np.abs(facts[:3] - (low + high) / 2) <= facts[3:6] + (high - low) / 2).all(axis=0)  # along the world's axes
    if may.any():
        inwards = np.array(((1.0, 0.0, -left), (-1.0, 0.0, right), (0.0, 1.0, -top), (0.0, -1.0, bottom)))
        planes = inwards @ optical.rotation.T
        may[may] = (reach_of_planes(planes, -(planes @ optical.eye)) @ facts[:, may]).min(axis=0) >= 0
    return np.asarray(may)


def edges_of(window: Window, size: int, camera: CameraConfig) -> Edges:
    """Returns the edges of a window of an image of `size` x `size` pixels."""
    reach = math.tan(math.radians(camera.fov_deg) / 2)
    top, left, bottom, right = ((2 * pixel / size - 1) * reach for pixel in window)
    return left, top, right, bottom


def window_of_corners(
    corners: NDArray[np.float64], clip: NDArray[np.float64], near_m: float, size: int
) -> tuple[Window, float]:
    """Returns the window of an image that contains the convex hull of some points, and their largest depth in metres.

    Args:
        corners: (N, 3) points in the world frame, metres; without points the window is empty.
        clip: (4, 4) matrix from world to OpenGL clip space, for column vectors; its w is the depth in metres.
        near_m: near distance of the camera, metres; a point closer than it gives the whole image.
        size: width and height of the image, pixels.
    """
    if not len(corners):
        return Window(0, 0, 0, 0), 0.0
    x, y, _, w = clip[:, :3] @ corners.T + clip[:, 3:]
    if w.min() <= near_m:
        return Window(0, 0, size, size), float(w.max())
    columns, rows = (x / w + 1) / 2 * size, (1 - y / w) / 2 * size
    top, bottom = _pixels(rows, size)
    left, right = _pixels(columns, size)
    return Window(top, left, bottom, right), float(w.max())


def _pixels(places: NDArray[np.float64], size: int) -> tuple[int, int]:
    """Returns the first pixel of a range and the first one after it, with a margin for the rounding of corners."""
    first, last = math.floor(float(places.min())) - _MARGIN_PX, math.ceil(float(places.max())) + _MARGIN_PX
    return min(max(first, 0), size), min(max(last, 0), size)
