"""Computes the success regions of many targets at once. Pure functions. Does not consider obstacles."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from schemas.measure import Goal
from schemas.scene import Target
from schemas.support.approach import approach, ring, target_distances
from schemas.support.numpy_types import Floats

_AT_ONCE = 32
"""Number of targets whose arrays are computed together; these arrays fit the processor cache."""

Rows = NDArray[np.intp]


@dataclass(frozen=True)
class Goals:
    """Success regions of T targets by one measure; the results equal those of each `Goal`, bit for bit."""

    centres: Floats
    """(T, 2) centroids, metres."""
    reaches: Floats
    """(T, 2) half the extents of the targets' boxes, metres."""
    extents: Floats
    """(T,) largest distance of a vertex from the centroid, metres."""
    vertices: Floats | None
    """(K, T, 2) vertices of the footprints, metres, padded with the last vertex; `None` for the centroid measure."""

    @classmethod
    def of(cls, targets: Sequence[Target], goals: Sequence[Goal]) -> Goals:
        """Returns the goals of targets, all by the same measure."""
        most = max((len(goal.footprint_m) for goal in goals), default=0)
        padded = [(*goal.footprint_m, *goal.footprint_m[-1:] * (most - len(goal.footprint_m))) for goal in goals]
        return cls(
            centres=np.array([goal.centre_m for goal in goals]).reshape(-1, 2),
            reaches=np.array([target.size_m[:2] for target in targets]).reshape(-1, 2) / 2,
            extents=np.array([goal.extent_m for goal in goals]),
            vertices=np.array(padded).transpose(1, 0, 2) if most else None,
        )

    def chosen(self, rows: Rows) -> Goals:
        """Returns the goals at the given indices, one for each index."""
        vertices = None if self.vertices is None else self.vertices[:, rows]
        return Goals(self.centres[rows], self.reaches[rows], self.extents[rows], vertices)

    def ring(self, directions: Floats, distance_m: float) -> Floats:
        """Returns the points (T, N, 2) at a distance from each target, on rays with directions (N, 2)."""
        vertices = None if self.vertices is None else self.vertices[:, :, None]
        return ring(directions, np.asarray(distance_m), self.centres[:, None], self.extents[:, None], vertices)

    def approach(self, starts: Floats, distance_m: float) -> Floats:
        """Returns the points (T, 2) at which the line from each start to its target comes within a distance of it."""
        return approach(starts, np.asarray(distance_m), self.centres, self.vertices)

    def distances(self, points: Floats) -> Floats:
        """Returns the distances (T, N) of points (N, 2) to each target, metres."""
        vertices = None if self.vertices is None else self.vertices[:, :, None]
        spread = np.broadcast_to(points, (len(self.centres), *points.shape))
        return target_distances(spread, self.centres[:, None], vertices)


def batches(goals: Sequence[Goal]) -> Iterator[Rows]:
    """Yields the indices of all goals in batches; the goals of a batch have similar numbers of vertices."""
    order = np.argsort([len(goal.footprint_m) for goal in goals], kind="stable")
    for first in range(0, len(order), _AT_ONCE):
        yield order[first : first + _AT_ONCE]
