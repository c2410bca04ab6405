"""Distances along the floor: from every cell to where a target is reached, and the geodesic distance of a start.

Dijkstra over cells with 16 neighbours, then a taut string; knows nothing of headings.
"""

from __future__ import annotations

import functools
import math
from dataclasses import dataclass
from typing import NamedTuple, TypeVar

import numpy as np
import scipy  # loads a submodule at its first use: commands that only read need none
from numpy.typing import ArrayLike, NDArray

from schemas.scene import Target
from workers.geometry.grid import HALF_WIDTH_M, Grid

__all__ = ["FloorGraph", "arrival_cells", "geodesic_field", "geodesic_m"]

_NEIGHBOURS = ((0, 1), (1, 0), (1, 1), (1, -1), (1, 2), (2, 1), (1, -2), (2, -1))
"""Row and column steps, one of each opposite pair; no detour is longer than 2.8 % of the way."""

Floats = NDArray[np.float64]
Bools = NDArray[np.bool_]
Number = TypeVar("Number", np.int32, np.float64)


class DistanceField(NamedTuple):
    """Distances over the grid."""

    metres: Floats
    """(H, W) to the nearest source; infinite where there is no way."""
    nearer: NDArray[np.int32]
    """(H, W) flat number of the next cell on the way; negative at sources and where there is no way."""


@dataclass(frozen=True, eq=False)
class FloorGraph:
    """The cells that may be crossed, as a graph; built once, asked often."""

    numbers: NDArray[np.int32]
    """(H, W) number of the cell's node, -1 for cells that may not be crossed."""
    edges: scipy.sparse.coo_array
    """Length of the way between neighbours times the mean weight of the two cells, metres."""

    @classmethod
    def over(cls, passable: Bools, resolution_m: float, weight: Floats | None = None) -> FloorGraph:
        """Returns the graph of the passable cells (H, W); `weight` (H, W) makes some of them longer than they are."""
        numbers = np.full(passable.shape, -1, np.int32)
        numbers[passable] = np.arange(int(passable.sum()))
        weights = np.ones(passable.shape) if weight is None else weight
        ends: list[tuple[NDArray[np.int32], NDArray[np.int32], Floats]] = []
        for row, column in _NEIGHBOURS:
            here, there = _shifted(numbers, row, column)
            both = (here >= 0) & (there >= 0)
            mean = np.add(*_shifted(weights, row, column)) / 2
            ends.append((here[both], there[both], mean[both] * math.hypot(row, column) * resolution_m))
        starts, stops, lengths = (np.concatenate(column) for column in zip(*ends, strict=True))
        count = int(passable.sum())
        return cls(numbers, scipy.sparse.coo_array((lengths, (starts, stops)), shape=(count, count)).tocsr())

    def distances(self, sources: Bools) -> DistanceField:
        """Returns the distance from every cell to the nearest of the source cells (H, W)."""
        metres = np.full(self.numbers.shape, np.inf)
        nearer = np.full(self.numbers.shape, -1, np.int32)
        nodes = self.numbers[sources & (self.numbers >= 0)]
        if len(nodes) == 0:
            return DistanceField(metres, nearer)
        passable = self.numbers >= 0
        found, before, _ = scipy.sparse.csgraph.dijkstra(
            self.edges, directed=False, indices=nodes, min_only=True, return_predecessors=True
        )
        cells = np.flatnonzero(passable)
        metres[passable] = found
        nearer[passable] = np.where(before >= 0, cells[np.maximum(before, 0)], -1)
        return DistanceField(metres, nearer)


def _shifted(field: NDArray[Number], row: int, column: int) -> tuple[NDArray[Number], NDArray[Number]]:
    """The field and the field a step further, cut to where both are."""
    height, width = field.shape
    here = field[: height - row, max(0, -column) : width - max(0, column)]
    there = field[row:, max(0, column) : width - max(0, -column)]
    return here, there


def arrival_cells(grid: Grid, target: Target, radius_m: float) -> Bools:
    """Returns (H, W) the cells within a planar radius of a target's centroid and in sight of it."""
    rows, columns = np.indices(grid.occupancy.shape)
    points = grid.centre_of(np.stack([rows, columns], axis=-1))
    near = np.linalg.norm(points - np.asarray(target.centroid_m[:2]), axis=-1) <= radius_m
    near[near] = grid.have_sight(points[near], target)
    return np.asarray(near)


@functools.lru_cache(maxsize=8)
def geodesic_field(grid: Grid, target: Target, radius_m: float) -> DistanceField:
    """Returns the distance along the floor to the part of the success circle that has sight of the target.

    The way is base_link's, and leaves half the robot's width on both sides of it.
    """
    return _wide_floor(grid).distances(arrival_cells(grid, target, radius_m))


@functools.lru_cache(maxsize=2)
def _wide_floor(grid: Grid) -> FloorGraph:
    return FloorGraph.over(grid.clearance >= HALF_WIDTH_M, grid.resolution_m)


def geodesic_m(grid: Grid, start_xy: ArrayLike, target: Target, radius_m: float) -> float | None:
    """Returns the length of the shortest way from a start to the success circle, metres; the l of SPL.

    The cells' way is pulled taut, so that a free straight line counts as its length; where the start has one, no way is
    looked for, which takes as long as two frames. `None` where no way is.

    Args:
        grid: of the scene.
        start_xy: base_link, world frame, metres.
        target: to reach.
        radius_m: success radius.
    """
    straight = _straight_m(grid, np.asarray(start_xy, float), target, radius_m)
    if straight is not None:
        return straight
    field = geodesic_field(grid, target, radius_m)
    if not math.isfinite(float(grid.values_at(field.metres, start_xy, np.inf))):
        return None
    return _taut_length(grid, _way(grid, field, start_xy), target, radius_m)


def _way(grid: Grid, field: DistanceField, start_xy: ArrayLike) -> Floats:
    """The points (N, 2) of the cells' way, the start itself first."""
    start = np.asarray(start_xy, float)
    row, column = grid.cell_of(start)
    width = field.nearer.shape[1]
    cells = [int(row) * width + int(column)]
    while (following := int(field.nearer.flat[cells[-1]])) >= 0:
        cells.append(following)
    points = grid.centre_of(np.stack(np.divmod(np.array(cells), width), axis=-1))
    points[0] = start
    return points


def _taut_length(grid: Grid, way: Floats, target: Target, radius_m: float) -> float:
    """Length of the way with every bend cut that the floor lets cut; it ends where it enters the circle."""
    length, at = 0.0, 0
    while at < len(way) - 1:
        straight = _straight_m(grid, way[at], target, radius_m)
        if straight is not None:
            return length + straight
        ahead = _farthest_in_line(grid, way, at)
        length += math.dist(way[ahead], way[at])
        at = ahead
    return length


def _straight_m(grid: Grid, point: Floats, target: Target, radius_m: float) -> float | None:
    """Length of the straight line from a point into the circle, 0 inside it; `None` where the floor is not free, or the
    line ends out of the target's sight."""
    centre = np.asarray(target.centroid_m[:2])
    gap = math.dist(point, centre) - radius_m
    if gap <= 0:
        return 0.0
    entry = point + (centre - point) * (gap / (gap + radius_m))
    return gap if _is_clear(grid, point, entry) and grid.has_sight(entry, target) else None


def _farthest_in_line(grid: Grid, way: Floats, at: int) -> int:
    """Number of the last point that can be reached straight; at least the next one."""
    low, high = at + 1, len(way) - 1
    while low < high:  # bisection: what lies farther along the way is less likely in line
        middle = (low + high + 1) // 2
        if _is_clear(grid, way[at], way[middle]):
            low = middle
        else:
            high = middle - 1
    return low


def _is_clear(grid: Grid, start: Floats, end: Floats) -> bool:
    steps = max(2, math.ceil(math.dist(start, end) / (grid.resolution_m / 2)))
    points = start + (end - start) * np.linspace(0, 1, steps)[:, None]
    return bool((grid.clearance_at(points) >= HALF_WIDTH_M).all())
