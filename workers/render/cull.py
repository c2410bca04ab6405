"""Which parts of a scene the camera can see at all, nearest far corner first.

Pure geometry on bounding boxes; it never draws, and what one part hides of another is left to the depth test.
"""

from __future__ import annotations

import functools
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from schemas.scene import CompiledScene

__all__ = ["PartBounds", "reach_of_planes", "visible_parts"]


@dataclass(frozen=True)
class PartBounds:
    """Bounding boxes along the world axes, one a part."""

    centre: NDArray[np.float64]
    """(P, 3) metres."""
    half: NDArray[np.float64]
    """(P, 3) half extents, metres; negative infinity for a part without vertices, which nothing can see."""

    @classmethod
    def of(cls, scene: CompiledScene) -> PartBounds:
        """Measures the parts of a scene."""
        count = len(scene.part_first)
        centre, half = np.zeros((count, 3)), np.full((count, 3), -np.inf)
        for part in np.flatnonzero(scene.part_count):
            first = scene.part_first[part]
            corners = scene.positions[first : first + scene.part_count[part]].astype(np.float64)
            low, high = corners.min(axis=0), corners.max(axis=0)
            centre[part], half[part] = (low + high) / 2, (high - low) / 2
        return cls(centre, half)

    @functools.cached_property
    def facts(self) -> NDArray[np.float64]:
        """(7, P) centre, half extents and 1: what a plane is multiplied with to tell how far each box reaches."""
        return np.ascontiguousarray(np.column_stack((self.centre, self.half, np.ones(len(self.centre)))).T)


def reach_of_planes(normals: NDArray[np.float64], offsets: NDArray[np.float64]) -> NDArray[np.float64]:
    """Returns (N, 7) rows that, times `PartBounds.facts`, give the height of each box's highest corner above a plane.

    Args:
        normals: (N, 3) of the planes n x + offset = 0, of any length.
        offsets: (N,)
    """
    return np.column_stack((normals, np.abs(normals), offsets))


def visible_parts(bounds: PartBounds, clip: NDArray[np.float64], eye: NDArray[np.float64]) -> NDArray[np.intp]:
    """Returns the indices of the parts whose box reaches into the view; the one whose far corner is nearest first.

    By that order a floor comes after what stands on it, and is drawn where it is seen.

    Args:
        bounds: of the parts.
        clip: (4, 4) from world to OpenGL clip space, for columns.
        eye: (3,) the camera's place in the world, metres.
    """
    w = clip[3]
    planes = np.concatenate((w + clip[:3], w - clip[:3]))  # left, bottom, near, right, top, far; inside is positive
    reach = reach_of_planes(planes[:, :3], planes[:, 3]) @ bounds.facts
    seen = np.flatnonzero(reach.min(axis=0) >= 0)
    far = np.abs(bounds.centre[seen] - eye) + bounds.half[seen]
    return seen[np.argsort(np.einsum("ij,ij->i", far, far), kind="stable")]
