"""Distances along the floor: from every cell to the success region of a target, and the geodesic distance of a start.

Uses Dijkstra's algorithm on cells with 16 neighbours, then shortens the path to straight segments. Ignores headings.
"""

from __future__ import annotations

import functools
import math
from dataclasses import dataclass
from typing import NamedTuple, TypeVar

import numpy as np
import scipy  # loads a submodule at its first use; many commands use no submodule
from numpy.typing import ArrayLike, NDArray

from schemas.config import TaskConfig
from schemas.measure import Goal
from schemas.scene import Target
from schemas.support.numpy_types import Bools, Floats
from workers.geometry.grid import HALF_WIDTH_M, Grid
from workers.planning.kept import kept_with_grid

_NEIGHBOURS = ((0, 1), (1, 0), (1, 1), (1, -1), (1, 2), (2, 1), (1, -2), (2, -1))
"""Row and column steps to 8 of the 16 neighbours of a cell; the steps to the other 8 are opposite. A path of such steps
is at most 2.8 % longer than the straight line."""

_NEAR_M = 6.0
"""Limit of the first search, metres. From a start within half this distance of the goal, only paths up to this length
are searched first."""

Number = TypeVar("Number", np.int32, np.float64)


class DistanceField(NamedTuple):
    """Distances of all cells of a grid to the nearest source."""

    metres: Floats
    """(H, W) distance to the nearest source, metres; infinite if no path exists."""
    nearer: NDArray[np.int32]
    """(H, W) flat index of the next cell on the path; negative at sources and if no path exists."""


@dataclass(frozen=True, eq=False)
class FloorGraph:
    """Graph of the passable cells; it is built once and queried often."""

    numbers: NDArray[np.int32]
    """(H, W) number of the cell's node, -1 for impassable cells."""
    edges: scipy.sparse.csr_array
    """Distance between neighbours times the mean weight of the two cells, metres. Edges are stored in both directions;
    otherwise scipy would add the reverse edges in every search."""

    @classmethod
    def over(cls, passable: Bools, resolution_m: float, weight: Floats | None = None) -> FloorGraph:
        """Returns the graph of the passable cells (H, W).

        Args:
            passable: (H, W) true for passable cells.
            resolution_m: side of a cell, metres.
            weight: (H, W) factor of the length of a path in each cell; `None` for 1.
        """
        numbers = np.full(passable.shape, -1, np.int32)
        numbers[passable] = np.arange(int(passable.sum()))
        weights = np.ones(passable.shape) if weight is None else weight
        return cls(numbers, _both_ways(_edges_ahead(numbers, weights, resolution_m)))

    def distances(self, sources: Bools, limit_m: float = math.inf) -> DistanceField:
        """Returns the distance from every cell to the nearest of the source cells (H, W).

        Args:
            sources: (H, W) true for source cells.
            limit_m: distance beyond which no path is searched; it does not change smaller distances.
        """
        metres = np.full(self.numbers.shape, np.inf)
        nearer = np.full(self.numbers.shape, -1, np.int32)
        nodes = self.numbers[sources & (self.numbers >= 0)]
        if len(nodes) == 0:
            return DistanceField(metres, nearer)
        passable = self.numbers >= 0
        field, before, _ = scipy.sparse.csgraph.dijkstra(
            self.edges, indices=nodes, min_only=True, return_predecessors=True, limit=limit_m
        )
        cells = np.flatnonzero(passable)
        metres[passable] = field
        nearer[passable] = np.where(before >= 0, cells[np.maximum(before, 0)], -1)
        return DistanceField(metres, nearer)


def _edges_ahead(numbers: NDArray[np.int32], weights: Floats, resolution_m: float) -> scipy.sparse.csr_array:
    """Returns the lengths of the edges from each node to its neighbours in the directions `_NEIGHBOURS`, metres."""
    ends: list[tuple[NDArray[np.int32], NDArray[np.int32], Floats]] = []
    for row, column in _NEIGHBOURS:
        here, there = _shifted(numbers, row, column)
        both = (here >= 0) & (there >= 0)
        mean = np.add(*_shifted(weights, row, column)) / 2
        ends.append((here[both], there[both], mean[both] * math.hypot(row, column) * resolution_m))
    starts, stops, lengths = (np.concatenate(column) for column in zip(*ends, strict=True))
    count = int(numbers.max(initial=-1)) + 1
    return scipy.sparse.coo_array((lengths, (starts, stops)), shape=(count, count)).tocsr()


def _both_ways(ahead: scipy.sparse.csr_array) -> scipy.sparse.csr_array:
    """Returns a graph with every edge and its reverse; in each row the edges of `ahead` are first.

    Of several shortest paths, the search keeps the first one that it finds, which depends on the order of the edges.
    """
    back = ahead.T.tocsr()
    lengths, stops = np.empty(2 * ahead.nnz), np.empty(2 * ahead.nnz, np.int32)
    for half, others_before in ((ahead, back.indptr[:-1]), (back, ahead.indptr[1:])):
        places = np.arange(half.nnz, dtype=np.int32) + np.repeat(others_before, np.diff(half.indptr))
        lengths[places], stops[places] = half.data, half.indices
    return scipy.sparse.csr_array((lengths, stops, ahead.indptr + back.indptr), shape=ahead.shape)


def _shifted(field: NDArray[Number], row: int, column: int) -> tuple[NDArray[Number], NDArray[Number]]:
    """Returns the field and the field shifted by a number of rows and columns, both cropped to their common cells."""
    height, width = field.shape
    here = field[: height - row, max(0, -column) : width - max(0, column)]
    there = field[row:, max(0, column) : width - max(0, -column)]
    return here, there


def cells_within(grid: Grid, goal: Goal) -> Bools:
    """Returns the cells (H, W) whose centres are in a goal."""
    within, reach_m = np.zeros(grid.occupancy.shape, bool), goal.radius_m + goal.extent_m
    low, high = (grid.cell_of(np.asarray(goal.centre_m) + side * reach_m) for side in (-1, 1))
    first, last = np.maximum(low, 0), np.minimum(high + 1, within.shape)
    if (first >= last).any():
        return within
    cells = np.stack(np.meshgrid(*map(np.arange, first, last), indexing="ij"), axis=-1)
    points = grid.centre_of(cells)
    near = np.linalg.norm(points - np.asarray(goal.centre_m), axis=-1) <= reach_m
    near[near] = goal.distances(points[near]) <= goal.radius_m
    within[first[0] : last[0], first[1] : last[1]] = near
    return within


def arrival_cells(grid: Grid, target: Target, goal: Goal) -> Bools:
    """Returns the cells (H, W) in the goal of a target that have line of sight to it."""
    near = cells_within(grid, goal)
    near[near] = grid.have_sight(grid.centre_of(np.argwhere(near)), target)
    return near


def geodesic_field(grid: Grid, target: Target, task: TaskConfig) -> DistanceField:
    """Returns the distances along the floor to the part of the success region with line of sight to the target.

    The path is that of base_link, with a clearance of half the robot's width.
    """
    return _field_within(grid, target, task, math.inf)


@kept_with_grid(4)
def _field_within(grid: Grid, target: Target, task: TaskConfig, limit_m: float) -> DistanceField:
    return _wide_floor(grid).distances(arrival_cells(grid, target, Goal.of(target, task)), limit_m)


@kept_with_grid(1)
def _wide_floor(grid: Grid) -> FloorGraph:
    return FloorGraph.over(grid.clearance >= HALF_WIDTH_M, grid.resolution_m)


def geodesic_m(grid: Grid, start_xy: ArrayLike, target: Target, task: TaskConfig) -> float | None:
    """Returns the length of the shortest path from a start to the success region, metres; the l of SPL.

    The path of cells is shortened to straight segments, so it is not longer than a free straight line. If the
    straight line from the start is free, no path is searched, because a search takes as long as two frames.

    Args:
        grid: occupancy grid of the scene.
        start_xy: x, y of base_link in the world frame, metres.
        target: target to reach.
        task: success measure and radius.

    Returns:
        The length, or `None` if no path exists.
    """
    # not the length of the planner's path, with which SPL would depend on the planner's settings
    goal = Goal.of(target, task)
    straight = _straight_m(grid, np.asarray(start_xy, float), target, goal)
    if straight is not None:
        return straight
    is_near = goal.entry(np.asarray(start_xy, float))[0] < _NEAR_M / 2
    for limit_m in (_NEAR_M, math.inf) if is_near else (math.inf,):  # a short search suffices for most starts
        field = _field_within(grid, target, task, limit_m)
        if math.isfinite(float(grid.values_at(field.metres, start_xy, np.inf))):
            return _shortened_length(grid, _cell_path(grid, field, start_xy), target, goal)
    return None


def is_way_straight(grid: Grid, start_xy: ArrayLike, target: Target, task: TaskConfig) -> bool:
    """Returns whether the straight line from a start to the success region is free and ends in sight of the target."""
    return _straight_m(grid, np.asarray(start_xy, float), target, Goal.of(target, task)) is not None


def _cell_path(grid: Grid, field: DistanceField, start_xy: ArrayLike) -> Floats:
    """Returns the centres (N, 2) of the cells on the path from a start; the first point is the start itself."""
    start = np.asarray(start_xy, float)
    row, column = grid.cell_of(start)
    width = field.nearer.shape[1]
    cells = [int(row) * width + int(column)]
    while (following := int(field.nearer.flat[cells[-1]])) >= 0:
        cells.append(following)
    points = grid.centre_of(np.stack(np.divmod(np.array(cells), width), axis=-1))
    points[0] = start
    return points


def _shortened_length(grid: Grid, way: Floats, target: Target, goal: Goal) -> float:
    """Returns the length of the path after shortening to straight segments, up to its entry into the goal, metres."""
    length, at = 0.0, 0
    while at < len(way) - 1:
        straight = _straight_m(grid, way[at], target, goal)
        if straight is not None:
            return length + straight
        ahead = _farthest_in_line(grid, way, at)
        length += math.dist(way[ahead], way[at])
        at = ahead
    return length


def _straight_m(grid: Grid, point: Floats, target: Target, goal: Goal) -> float | None:
    """Returns the length of the straight line from a point to the goal, 0 inside it, metres; `None` if the line is
    not free, or its end has no line of sight to the target."""
    gap, entry = goal.entry(point)
    if gap <= 0:
        return 0.0
    return gap if _is_clear(grid, point, entry) and grid.has_sight(entry, target) else None


def _farthest_in_line(grid: Grid, way: Floats, at: int) -> int:
    """Returns the index of the last point with a free straight line from `at`; at least the next one."""
    low, high = at + 1, len(way) - 1
    while low < high:  # bisection: a point farther along the path is less likely to have a free straight line
        middle = (low + high + 1) // 2
        if _is_clear(grid, way[at], way[middle]):
            low = middle
        else:
            high = middle - 1
    return low


def _is_clear(grid: Grid, start: Floats, end: Floats) -> bool:
    steps = max(2, math.ceil(math.dist(start, end) / (grid.resolution_m / 2)))
    points = start + (end - start) * _shares(steps)
    return bool((grid.clearance_at(points) >= HALF_WIDTH_M).all())


@functools.lru_cache(maxsize=1024)
def _shares(steps: int) -> Floats:
    return np.linspace(0, 1, steps)[:, None]
