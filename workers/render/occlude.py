"""Which parts stand wholly behind one wall and need not be drawn; walls are found in the scene's own triangles.

Pure geometry; it errs on the side of drawing, so that an image is the same with and without it.
"""

from __future__ import annotations

import functools
import math
from dataclasses import dataclass
from typing import Self

import numpy as np
from numpy.typing import NDArray

from schemas.config import CameraConfig
from schemas.scene import CompiledScene
from workers.geometry.camera import OpticalPose
from workers.render.cull import PartBounds, reach_of_planes

__all__ = ["Screens"]

F64 = NDArray[np.float64]

_LEAST_AREA_M2 = 0.5
"""Rectangles smaller than this hide too little to be asked. Boxes in a rack are larger, and hide the next rack's."""
_MOST_ASKED = 16
"""Rectangles asked a frame: those that fill most of the view."""
_SAME_M = 1e-4
"""Corners closer than this are one."""
_MARGIN_M = 0.005
"""How far inside the shadow of a rectangle a box must lie: more than rounding and the depth buffer's steps."""


@dataclass(frozen=True, eq=False)
class Screens:
    """Large flat rectangles that hide what stands behind them, seen from the side they face."""

    corners: F64
    """(S, 4, 3) metres, counter-clockwise seen from the side they face."""
    normals: F64
    """(S, 3) unit vectors towards that side."""
    areas: F64
    """(S,) square metres."""

    @functools.cached_property
    def _heights(self) -> F64:
        """(S,) how far along its normal each rectangle lies, metres."""
        return np.asarray(np.einsum("sk,sk->s", self.normals, self.corners[:, 0]))

    @functools.cached_property
    def _centres(self) -> F64:
        """(S, 3) metres."""
        return np.asarray(self.corners.mean(axis=1))

    @functools.cached_property
    def _radii(self) -> F64:
        """(S,) from the centre to the farthest corner, metres."""
        return np.asarray(np.linalg.norm(self.corners - self._centres[:, None], axis=2).max(axis=1, initial=0.0))

    @functools.cached_property
    def _edges(self) -> tuple[F64, F64]:
        """(S, 4, 3) each: the cross product of an edge's end with its start, and the edge itself."""
        ends = np.roll(self.corners, -1, axis=1)
        return np.cross(ends, self.corners), ends - self.corners

    @classmethod
    def of(cls, scene: CompiledScene) -> Self:
        """Finds the rectangles made up of two neighbours in the list of triangles, as far as they have parts behind."""
        triangles = scene.positions.reshape(-1, 3, 3).astype(np.float64)
        corners = _rectangles(triangles[:-1], triangles[1:])
        across = np.cross(corners[:, 1] - corners[:, 0], corners[:, 3] - corners[:, 0])
        areas = np.linalg.norm(across, axis=1)
        large = areas >= _LEAST_AREA_M2
        found = cls(corners[large], across[large] / areas[large, None], areas[large])
        useful = found._have_parts_behind(PartBounds.of(scene))  # not so the outer walls
        return cls(found.corners[useful], found.normals[useful], found.areas[useful])

    def _have_parts_behind(self, bounds: PartBounds) -> NDArray[np.bool_]:
        parts = np.isfinite(bounds.half).all(axis=1)  # the others have no vertices
        highest = self.normals @ bounds.centre[parts].T + np.abs(self.normals) @ bounds.half[parts].T
        return np.asarray(highest.min(axis=1, initial=np.inf) < self._heights - _MARGIN_M)

    def hidden(
        self, bounds: PartBounds, parts: NDArray[np.intp], optical: OpticalPose, camera: CameraConfig
    ) -> NDArray[np.bool_]:
        """Returns (len(parts),) true where a part lies wholly in the shadow of one rectangle.

        Args:
            bounds: of all parts.
            parts: indices of those to judge.
            optical: where the camera is.
            camera: gives near plane and field of view.
        """
        planes, offsets = self._shadows(optical, camera)
        high = reach_of_planes(-planes, -offsets) @ bounds.facts[:, parts]  # over the planes turned round
        within = high.reshape(5, len(planes) // 5, len(parts)).max(axis=0) < -_MARGIN_M
        return np.asarray(within.any(axis=0))

    def _shadows(self, optical: OpticalPose, camera: CameraConfig) -> tuple[F64, F64]:
        """Returns the planes of the shadows, the first of every rectangle first: (5 R, 3) normals to the inside and
        (5 R,) offsets.

        A shadow is what lies behind the rectangle and between the four planes through the eye and its edges. The plane
        through the eye e and an edge from p to q has the normal (q - e) x (p - e) = q x p + e x (q - p).
        """
        chosen = self._choose(optical, camera)
        x, y, z = optical.eye.tolist()
        times_eye = np.array(((0.0, z, -y), (-z, 0.0, x), (y, -x, 0.0)))  # v @ it is the cross product of e and v
        moments, edges = self._edges
        sides = moments[chosen] + edges[chosen] @ times_eye
        sides /= np.sqrt(np.einsum("rpk,rpk->rp", sides, sides))[:, :, None]
        planes = np.concatenate((sides, -self.normals[chosen, None]), axis=1)
        offsets = -(planes @ optical.eye)
        offsets[:, 4] = self._heights[chosen]
        return planes.transpose(1, 0, 2).reshape(-1, 3), offsets.T.ravel()

    def _choose(self, optical: OpticalPose, camera: CameraConfig) -> NDArray[np.intp]:
        """Returns the rectangles that face the eye, are not behind it or cut by the near plane, and look largest."""
        height = self.normals @ optical.eye - self._heights
        away = self._centres - optical.eye
        square = np.einsum("sk,sk->s", away, away)
        nearest = camera.near_m * math.sqrt(1 + 2 * math.tan(math.radians(camera.fov_deg) / 2) ** 2)
        can_hide = (height > nearest + _MARGIN_M) & (away @ optical.rotation[:, 2] > -self._radii)
        size = self.areas * height / (square * np.sqrt(square)) * can_hide
        if len(size) > _MOST_ASKED:
            size[np.argpartition(size, -_MOST_ASKED)[:-_MOST_ASKED]] = 0.0
        return np.flatnonzero(size)


def _rectangles(first: NDArray[np.float64], second: NDArray[np.float64]) -> F64:
    """Returns (R, 4, 3) corners of the pairs of triangles that make up a rectangle, in the order of the first one.

    Args:
        first: (N, 3, 3) corners of triangles.
        second: (N, 3, 3) corners of their partners.
    """
    same: NDArray[np.bool_] = np.asarray((np.abs(first[:, :, None] - second[:, None]) < _SAME_M).all(axis=3))
    is_pair = same.sum(axis=(1, 2)) == 2
    first, second, same = first[is_pair], second[is_pair], same[is_pair]
    own, other = (~same.any(axis=2)).argmax(axis=1), (~same.any(axis=1)).argmax(axis=1)
    rows = np.arange(len(first))
    # from the corner that is only the first one's: it, the next, the partner's own corner, the one before
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
