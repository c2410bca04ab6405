"""Hybrid A* search with forward moves only, from a start pose to the success region of a target.

Deterministic: the same grid, start, target and settings give the same path. The limit of a search is a number of
expansions, not a time.

Design: docs/design/experts.md#a-planner-of-this-project.
"""

from __future__ import annotations

import heapq
import math
from collections.abc import Iterable
from typing import Any, NamedTuple, Self

import numpy as np
from numpy.typing import NDArray

from schemas.config import PlannerConfig, TaskConfig
from schemas.measure import Goal
from schemas.scene import Target
from schemas.support import portable
from workers.geometry.grid import DISC_RADIUS_M, Grid
from workers.planning.distance import FloorGraph, arrival_cells, cells_within
from workers.planning.kept import kept_with_grid
from workers.planning.lattice import HEADINGS, MOVES, PoseTable, Waypoint, heading_of, pose_table, yaw_at

_CELL_M = 0.1
"""Side of the cells in which two poses with one heading count as one state, metres."""
_TURN_COST_M, _SPOT_TURN_COST_M = 0.02, 0.06
"""Cost of a turn by one heading, metres of path: along an arc, and on the spot. The latter is higher, because the robot
must stop."""
_AHEAD_RAD = 0.44
"""Largest angle between the heading at the end of a path and the target's centroid, if it must be ahead, radians."""
_MOVING_M = 0.15
"""Distance from the success region, metres, within which a path has no turn on the spot if it must end with the target
ahead."""
_NEAR_M, _LIMIT_MARGIN_M = 6.0, 0.5
"""Limit of the first distance field, metres; only starts within half this distance of the target use this field. The
second value is the margin by which the estimated cost of a path must be below the limit of the field, metres; it is
larger than the distance between two cells that share a state of the search."""
_WIDE_M, _NARROW_COST = 0.6, 0.8
"""Clearance at and above which a path has no extra cost, metres. The second value is the largest extra cost, as a
fraction of the length of the path; it applies where the clearance is `DISC_RADIUS_M` or less."""


class GoalFields:
    """Ends and distance fields of the paths to one target, kept for many starts: they take 84 % of the time of a plan.

    Args:
        grid: occupancy grid of the scene.
        target: target to reach.
        task: success measure and radius.
        facing: whether paths end with the target ahead.
    """

    def __init__(self, grid: Grid, target: Target, task: TaskConfig, *, facing: bool) -> None:
        self._grid, self._target, self._facing = grid, target, facing
        self.goal = Goal.of(target, task)
        self._ends: dict[float, _Ends] = {}
        self._fields: dict[tuple[float, float, float], NDArray[np.float64]] = {}

    def ends(self, arrival_margin_m: float) -> _Ends:
        """Returns the poses at which a path may end, at least a margin inside the success region."""
        if arrival_margin_m not in self._ends:
            arrival = arrival_cells(self._grid, self._target, self.goal.shrunk(arrival_margin_m))
            facing = self._facing
            self._ends[arrival_margin_m] = (
                _Ends.facing(self._grid, arrival, self.goal) if facing else _Ends.any_heading(arrival)
            )
        return self._ends[arrival_margin_m]

    def to_go(self, margin_m: float, arrival_margin_m: float, limit_m: float) -> NDArray[np.float64]:
        """Returns the distances (H, W) along the floor to the ends, metres; infinite beyond the limit."""
        key = margin_m, arrival_margin_m, limit_m
        if key not in self._fields:
            graph = _floor_graph(self._grid, margin_m)
            self._fields[key] = graph.distances(self.ends(arrival_margin_m).cells, limit_m).metres
        return self._fields[key]


def plan_path(
    grid: Grid,
    start: Waypoint,
    target: Target,
    task: TaskConfig,
    config: PlannerConfig,
    *,
    facing: bool = False,
    kept: GoalFields | None = None,
) -> tuple[Waypoint, ...] | None:
    """Returns a path from the start to a pose inside the success region with line of sight to the target.

    Consecutive poses are at most 0.2 m apart. A forward arc connects them or, if they have the same position, a turn on
    the spot. The search uses the wide margins first, then the tight ones.

    Args:
        grid: occupancy grid of the scene.
        start: pose of base_link.
        target: target to reach.
        task: success measure and radius; the path ends at least the arrival margin inside the region.
        config: margins and limits.
        facing: whether the path ends with the target ahead, and has no turn on the spot inside or near the region,
            because the episode ends when the robot stands still inside the region.
        kept: fields of this grid, target, task and `facing`, to plan from many starts; `None` computes new ones. The
            path is the same.

    Returns:
        The path, or `None` if none exists or the search reached its limit.
    """
    tries = (
        (config.margin_m, config.arrival_margin_m),
        (config.tight_margin_m, config.arrival_margin_m),
        (config.tight_margin_m, config.tight_arrival_margin_m),
    )
    fields = kept or GoalFields(grid, target, task, facing=facing)
    is_near = kept is None and fields.goal.distance(start.x, start.y) < _NEAR_M / 2
    limits_m = (_NEAR_M, math.inf) if is_near else (math.inf,)
    for margin, arrival_margin in tries:
        table = pose_table(grid, margin)
        if table.holds(grid, *start):
            path = _search(grid, table, (margin, arrival_margin), start, fields, config.max_expansions, limits_m)
            if path is not None:
                return path
    return None


@kept_with_grid(1)
def _weights(grid: Grid) -> NDArray[np.float64]:
    """Returns the costs (H, W) of the cells per metre of path, at least 1; they are higher where clearance is small."""
    lack = np.clip((_WIDE_M - grid.clearance) / (_WIDE_M - DISC_RADIUS_M), 0.0, 1.0)
    weights: NDArray[np.float64] = 1.0 + _NARROW_COST * lack**2
    return weights


@kept_with_grid(1)
def _weight_list(grid: Grid) -> list[float]:
    return _weights(grid).ravel().tolist()


@kept_with_grid(2)
def _floor_graph(grid: Grid, margin_m: float) -> FloorGraph:
    return FloorGraph.over(pose_table(grid, margin_m).floor, grid.resolution_m, _weights(grid))


class _Ends(NamedTuple):
    """Poses at which a path may end, and cells on which it may not turn on the spot."""

    cells: NDArray[np.bool_]
    """(H, W) cells with at least one heading at which a path may end."""
    poses: NDArray[np.bool_]
    """(HEADINGS, H, W) poses at which a path may end, or (1, H, W) if the heading does not matter."""
    moving: NDArray[np.bool_]
    """(H, W) cells without turns on the spot."""

    @classmethod
    def any_heading(cls, arrival: NDArray[np.bool_]) -> Self:
        return cls(arrival, arrival[None], np.zeros_like(arrival))

    @classmethod
    def facing(cls, grid: Grid, arrival: NDArray[np.bool_], goal: Goal) -> Self:
        poses = np.zeros((HEADINGS, *arrival.shape), bool)
        ahead = np.asarray(goal.centre_m) - grid.centre_of(np.argwhere(arrival))
        bearing = portable.arctan2(ahead[:, 1], ahead[:, 0])
        for heading in range(HEADINGS):
            error = np.remainder(bearing - yaw_at(heading) + math.pi, 2 * math.pi) - math.pi
            poses[heading][arrival] = np.abs(error) <= _AHEAD_RAD
        return cls(arrival, poses, cells_within(grid, goal.shrunk(-_MOVING_M)))


def _search(
    grid: Grid,
    table: PoseTable,
    margins_m: tuple[float, float],
    start: Waypoint,
    fields: GoalFields,
    max_expansions: int,
    limits_m: Iterable[float],
) -> tuple[Waypoint, ...] | None:
    """Searches once with each limit of the distance field, in turn, and returns the first path that is found.

    The result equals that of a search without a limit, because poses beyond a limit are expanded after all others.
    """
    for limit_m in limits_m:
        to_go = fields.to_go(*margins_m, limit_m)
        if math.isfinite(float(grid.values_at(to_go, start[:2], np.inf))):
            nodes = _expand(
                grid,
                table,
                to_go=to_go,
                start=start,
                ends=fields.ends(margins_m[1]),
                max_expansions=max_expansions,
                most_m=limit_m - _LIMIT_MARGIN_M,
            )
            if nodes is not None:
                return (start, *nodes)
    return None


_STRIDE = 1 << 16
"""The integer of a state is (column * `_STRIDE` + row) * HEADINGS + heading, where columns and rows count cells of side
`_CELL_M`. No grid has so many rows."""
_ARCS = tuple(tuple((*move[:6], move.turn * _TURN_COST_M) for move in moves if move.length_m) for moves in MOVES)
"""Arcs from each heading: displacements, heading, length, and cost of the turn, metres of path."""
_SPOT_TURNS = tuple(tuple(move.heading for move in moves if not move.length_m) for moves in MOVES)
"""Headings after a turn on the spot from each heading."""

Node = tuple[float, float, int, int]
"""x and y in metres, number of the heading, index of the previous node."""


def _expand(
    grid: Grid,
    table: PoseTable,
    to_go: NDArray[np.float64],
    start: Waypoint,
    ends: _Ends,
    max_expansions: int,
    most_m: float,
) -> list[Waypoint] | None:
    """Searches for a path with an estimated cost of at most `most_m`, metres; `None` if there is none.

    Free poses are more than a step from the edge of the grid, so all indices are valid.
    """
    flags = table.flags
    ahead: memoryview[Any] = to_go.reshape(-1).data
    goal, moving = ends.poses.reshape(-1).data, ends.moving.reshape(-1).data
    weights = _weight_list(grid)
    (left, low), per_cell = grid.origin_m, 1.0 / grid.resolution_m
    width, area = int(grid.occupancy.shape[1]), grid.occupancy.size
    goal_area = area if len(ends.poses) > 1 else 0
    x, y, heading = start.x, start.y, heading_of(start.yaw)
    here = int((y - low) * per_cell) * width + int((x - left) * per_cell)
    # a state is numbered by its heading and its cell; calls and tuples in these loops would double the time
    state = (int((x - left) / _CELL_M) * _STRIDE + int((y - low) / _CELL_M)) * HEADINGS + heading
    cost_at = {state: 0.0}
    heap = [(ahead[here], 0, 0.0, x, y, heading, -1, here, state)]
    nodes: list[Node] = []
    pushed = 0
    while heap and len(nodes) < max_expansions:
        estimate, _, cost, x, y, heading, before, here, state = heapq.heappop(heap)
        if cost > cost_at[state]:
            continue
        if estimate > most_m:
            return None
        number = len(nodes)
        nodes.append((x, y, heading, before))
        if goal[heading * goal_area + here]:
            return _trace(nodes)
        layer = heading * area
        for mid_x, mid_y, end_x, end_y, turned, length, extra in _ARCS[heading]:
            to_x, to_y = x + end_x, y + end_y
            spot = int((to_y - low) * per_cell) * width + int((to_x - left) * per_cell)
            if not flags[turned * area + spot]:
                continue
            if not flags[layer + int((y + mid_y - low) * per_cell) * width + int((x + mid_x - left) * per_cell)]:
                continue
            price = cost + length * weights[spot] + extra
            state_to = (int((to_x - left) / _CELL_M) * _STRIDE + int((to_y - low) / _CELL_M)) * HEADINGS + turned
            if price < cost_at.get(state_to, math.inf) - 1e-9 and ahead[spot] < math.inf:
                cost_at[state_to] = price
                pushed += 1
                heapq.heappush(heap, (price + ahead[spot], pushed, price, to_x, to_y, turned, number, spot, state_to))
        price = cost + _SPOT_TURN_COST_M
        for turned in () if moving[here] else _SPOT_TURNS[heading]:
            state_to = state - heading + turned
            if flags[turned * area + here] and price < cost_at.get(state_to, math.inf) - 1e-9:
                cost_at[state_to] = price
                pushed += 1
                heapq.heappush(heap, (price + ahead[here], pushed, price, x, y, turned, number, here, state_to))
    return None


def _trace(nodes: list[Node]) -> list[Waypoint]:
    """Returns the poses on the path to the last node; the first is the start with its heading rounded."""
    path: list[Waypoint] = []
    number = len(nodes) - 1
    while number >= 0:
        x, y, heading, number_before = nodes[number]
        path.append(Waypoint(x, y, yaw_at(heading)))
        number = number_before
    return path[::-1]
