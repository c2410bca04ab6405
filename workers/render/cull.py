"""View frustum culling: selects the parts of a scene in the camera's view, in order of their far corner, nearest first.

Pure geometry of bounding boxes. Does not render, and does not account for occlusion; the depth test does.
"""

from __future__ import annotations

import functools
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from schemas.scene import CompiledScene


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
        for part in np.flatnonzero(scene.part_count):
            first = scene.part_first[part]
            corners = scene.positions[first : first + scene.part_count[part]].astype(np.float64)
            low, high = corners.min(axis=0), corners.max(axis=0)
            centre[part], half[part] = (low + high) / 2, (high - low) / 2
        return cls(centre, half)

    @functools.cached_property
    def facts(self) -> NDArray[np.float64]:
        """(7, P) centre, half extents and 1, the right operand of the product with `reach_of_planes`."""
        return np.ascontiguousarray(np.column_stack((self.centre, self.half, np.ones(len(self.centre)))).T)


def reach_of_planes(normals: NDArray[np.float64], offsets: NDArray[np.float64]) -> NDArray[np.float64]:
    """Returns (N, 7) rows that, times `PartBounds.facts`, give the height of each box's highest corner above a plane.

    Args:
        normals: (N, 3) normals n of the planes n x + offset = 0, of any length.
        offsets: (N,) offsets of the planes.
    """
    return np.column_stack((normals, np.abs(normals), offsets))


def visible_parts(bounds: PartBounds, clip: NDArray[np.float64], eye: NDArray[np.float64]) -> NDArray[np.intp]:
    """Returns the indices of the parts whose box is at least partly in view, the one with the nearest far corner first.

    With this order a floor is drawn after the objects on it, so that its hidden pixels are not shaded.

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
