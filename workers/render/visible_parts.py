"""Selects the parts of a scene to draw: view frustum culling, then occlusion by one wall.

Pure geometry of bounding boxes, in order of the far corner, nearest first. The occlusion test is conservative, so an
image is the same with and without it.
"""

from __future__ import annotations

import functools
import itertools
import math
from dataclasses import dataclass
from typing import Self

import numpy as np
from numpy.typing import NDArray

from schemas.config import CameraConfig
from schemas.scene import CompiledScene
from schemas.support.geometry import cross
from workers.geometry.camera import OpticalPose, Perspective
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


def triangles_are_cut(scene: CompiledScene) -> NDArray[np.bool_]:
    """Returns whether the texture of each triangle (T,) cuts holes."""
    cut = np.zeros(len(scene.positions), bool)
    for part in np.flatnonzero(scene.part_is_cut):
        first = int(scene.part_first[part])
        cut[first : first + int(scene.part_count[part])] = True
    return cut[::3]


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


F64 = NDArray[np.float64]

_LEAST_AREA_M2 = 0.5
"""Smallest area of an occluder, square metres; smaller rectangles hide too few parts. The boxes in a rack have larger
sides, so they are occluders and hide the boxes of the next rack."""
_MOST_ASKED = 16
"""Largest number of occluders tested per frame; those with the largest image area are selected."""
_SAME_M = 1e-4
"""Largest distance between two corners that count as equal, metres."""
_MARGIN_M = 0.005
"""Distance by which a box must be inside the shadow of an occluder, metres; larger than rounding errors and the
resolution of the depth buffer."""


@dataclass(frozen=True, eq=False)
class Occluders:
    """Large flat rectangles that hide the parts behind them, seen from the side of their normal."""

    corners: F64
    """(S, 4, 3) corners, metres, counter-clockwise seen from the side of the normal."""
    normals: F64
    """(S, 3) unit normals."""
    areas: F64
    """(S,) areas, square metres."""

    @functools.cached_property
    def _heights(self) -> F64:
        """(S,) distance of each rectangle's plane from the origin along its normal, metres."""
        return np.asarray(np.einsum("sk,sk->s", self.normals, self.corners[:, 0]))

    @functools.cached_property
    def _centres(self) -> F64:
        """(S, 3) centres, metres."""
        return np.asarray(self.corners.mean(axis=1))

    @functools.cached_property
    def _radii(self) -> F64:
        """(S,) distance from the centre to the farthest corner, metres."""
        return np.asarray(np.linalg.norm(self.corners - self._centres[:, None], axis=2).max(axis=1, initial=0.0))

    @functools.cached_property
    def _edges(self) -> tuple[F64, F64]:
        """(S, 4, 3) cross products of each edge's end with its start, and (S, 4, 3) edges."""
        ends = np.roll(self.corners, -1, axis=1)
        return np.cross(ends, self.corners), ends - self.corners

    @classmethod
    def of(cls, scene: CompiledScene) -> Self:
        """Finds the rectangles that consist of two consecutive triangles and have parts behind them."""
        triangles = scene.positions.reshape(-1, 3, 3).astype(np.float64)
        first, second = triangles[:-1], triangles[1:]
        if scene.masks:  # what is behind a hole is visible
            is_whole = ~triangles_are_cut(scene)
            first, second = (some[is_whole[:-1] & is_whole[1:]] for some in (first, second))
        corners = _rectangles(first, second)
        across = np.cross(corners[:, 1] - corners[:, 0], corners[:, 3] - corners[:, 0])
        areas = np.linalg.norm(across, axis=1)
        large = areas >= _LEAST_AREA_M2
        occluders = cls(corners[large], across[large] / areas[large, None], areas[large])
        useful = occluders._have_parts_behind(PartBounds.of(scene))  # excludes outer walls, which hide nothing
        return cls(occluders.corners[useful], occluders.normals[useful], occluders.areas[useful])

    def _have_parts_behind(self, bounds: PartBounds) -> NDArray[np.bool_]:
        parts = np.isfinite(bounds.half).all(axis=1)  # excludes parts without vertices, which have infinite extents
        highest = self.normals @ bounds.centre[parts].T + np.abs(self.normals) @ bounds.half[parts].T
        return np.asarray(highest.min(axis=1, initial=np.inf) < self._heights - _MARGIN_M)

    def hidden(
        self, bounds: PartBounds, parts: NDArray[np.intp], optical: OpticalPose, view: Perspective
    ) -> NDArray[np.bool_]:
        """Returns whether each of the parts is completely hidden behind one rectangle.

        Args:
            bounds: bounding boxes of all parts.
            parts: indices of the parts to test.
            optical: pose of the camera.
            view: image of the camera, with near plane and field of view.
        """
        planes, offsets = self._shadows(optical, view)
        high = reach_of_planes(-planes, -offsets) @ bounds.facts[:, parts]  # positive on the outer side of a plane
        within = high.reshape(5, len(planes) // 5, len(parts)).max(axis=0) < -_MARGIN_M
        return np.asarray(within.any(axis=0))

    def _shadows(self, optical: OpticalPose, view: Perspective) -> tuple[F64, F64]:
        """Returns the planes of the shadows of R rectangles: (5 R, 3) normals that point inside, and (5 R,) offsets.

        The first R planes are the first plane of each shadow, the next R planes the second, and so on.
        A shadow is the space behind the rectangle and between the four planes through the eye and its edges. The plane
        through the eye e and an edge from p to q has the normal (q - e) x (p - e) = q x p + e x (q - p).
        """
        chosen = self._choose(optical, view)
        x, y, z = optical.eye.tolist()
        times_eye = np.array(((0.0, z, -y), (-z, 0.0, x), (y, -x, 0.0)))  # v @ times_eye = e x v
        moments, edges = self._edges
        sides = moments[chosen] + edges[chosen] @ times_eye
        sides /= np.sqrt(np.einsum("rpk,rpk->rp", sides, sides))[:, :, None]
        planes = np.concatenate((sides, -self.normals[chosen, None]), axis=1)
        offsets = -(planes @ optical.eye)
        offsets[:, 4] = self._heights[chosen]
        return planes.transpose(1, 0, 2).reshape(-1, 3), offsets.T.ravel()

    def _choose(self, optical: OpticalPose, view: Perspective) -> NDArray[np.intp]:
        """Returns those rectangles facing the eye, beyond the near plane, that have the largest area in the image."""
        height = self.normals @ optical.eye - self._heights
        away = self._centres - optical.eye
        square = np.einsum("sk,sk->s", away, away)
        nearest = view.near_m * view.corner
        can_hide = (height > nearest + _MARGIN_M) & (away @ optical.rotation[:, 2] > -self._radii)
        size = self.areas * height / (square * np.sqrt(square)) * can_hide
        if len(size) > _MOST_ASKED:
            size[np.argpartition(size, -_MOST_ASKED)[:-_MOST_ASKED]] = 0.0
        return np.flatnonzero(size)


def _are_large(triangles: F64) -> NDArray[np.bool_]:
    """Returns whether a rectangle of twice the area of each triangle (N, 3, 3) may be large enough."""
    sides, others = triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0]
    return np.asarray(np.linalg.norm(cross(sides, others), axis=1) > _LEAST_AREA_M2 / 2)


def _rectangles(first: NDArray[np.float64], second: NDArray[np.float64]) -> F64:
    """Returns (R, 4, 3) corners of the large rectangles that are formed by a first and a second triangle.

    The corners are in the winding order of the first triangle. Parallelograms count as rectangles.

    Args:
        first: (N, 3, 3) corners of the first triangles.
        second: (N, 3, 3) corners of the second triangles.
    """
    large = np.flatnonzero(_are_large(first))  # the first triangle is half of the rectangle
    first, second = first[large], second[large]
    same: NDArray[np.bool_] = np.asarray((np.abs(first[:, :, None] - second[:, None]) < _SAME_M).all(axis=3))
    is_pair = same.sum(axis=(1, 2)) == 2
    first, second, same = first[is_pair], second[is_pair], same[is_pair]
    first_other, other = (~same.any(axis=2)).argmax(axis=1), (~same.any(axis=1)).argmax(axis=1)
    rows = np.arange(len(first))
    # unshared corner of the first triangle, its next corner, unshared corner of the second, its previous corner
    corners = np.stack(
        (
            first[rows, first_other],
            first[rows, (first_other + 1) % 3],
            second[rows, other],
            first[rows, (first_other + 2) % 3],
        ),
        axis=1,
    )
    is_parallelogram = np.abs(corners[:, 0] + corners[:, 2] - corners[:, 1] - corners[:, 3]).max(axis=1) < _SAME_M
    return np.asarray(corners[is_parallelogram])
