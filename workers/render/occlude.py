"""Occlusion culling: finds the parts that are completely behind one wall; walls are large rectangles in the scene.

Pure geometry. The test is conservative, so an image is the same with and without it.
"""

from __future__ import annotations

import functools
from dataclasses import dataclass
from typing import Self

import numpy as np
from numpy.typing import NDArray

from schemas.scene import CompiledScene
from schemas.support.vectors import cross
from workers.geometry.camera import OpticalPose, Perspective
from workers.render.cull import PartBounds, reach_of_planes

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
        corners = _rectangles(triangles[:-1], triangles[1:])
        across = np.cross(corners[:, 1] - corners[:, 0], corners[:, 3] - corners[:, 0])
        areas = np.linalg.norm(across, axis=1)
        large = areas >= _LEAST_AREA_M2
        found = cls(corners[large], across[large] / areas[large, None], areas[large])
        useful = found._have_parts_behind(PartBounds.of(scene))  # excludes outer walls, which hide nothing
        return cls(found.corners[useful], found.normals[useful], found.areas[useful])

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
    own, other = (~same.any(axis=2)).argmax(axis=1), (~same.any(axis=1)).argmax(axis=1)
    rows = np.arange(len(first))
    # unshared corner of the first triangle, its next corner, unshared corner of the second, its previous corner
    corners = np.stack(
        (
            first[rows, own],
            first[rows, (own + 1) % 3],
            second[rows, other],
            first[rows, (own + 2) % 3],
        ),
        axis=1,
    )
    is_parallelogram = np.abs(corners[:, 0] + corners[:, 2] - corners[:, 1] - corners[:, 3]).max(axis=1) < _SAME_M
    return np.asarray(corners[is_parallelogram])
