"""Searches a scene for starts with a required view: several objects that could be the target, or the target alone.

Renders nothing. The starts are on a lattice over the connected floor, with evenly spaced headings, and visibility is
judged by lines of sight on the grid. So a start is a proposal: the worker moves it a little, and tests its image.

Design: docs/design/starts.md#searched-starts and docs/design/starts.md#targets-shown-alone.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from schemas.config import TaskConfig
from schemas.language.graph.scene_graph import SceneGraph
from schemas.language.graph.view import free_lines, have_sight, line_ends
from schemas.language.thresholds import SHOWN
from schemas.measure import Goal
from schemas.scene import CompiledScene, Target
from schemas.support import portable
from schemas.support.numpy_types import Bools, Floats
from schemas.terms import TIER_RANGE_M, Tier

STEP_M = 0.25
"""Distance between neighbouring points of the lattice, metres."""
STEP_RAD = math.radians(10)
"""Angle between neighbouring headings, radians."""
_CLEAR_STEP_M = 0.5
"""Distance between neighbouring points of the lattice for shares of starts, metres; a share needs fewer points."""
_HEADINGS = np.arange(-math.pi, math.pi - STEP_RAD / 2, STEP_RAD)
_FARTHEST_M = max(TIER_RANGE_M[tier][1] for tier in (Tier.NEAR, Tier.MID))


@dataclass(frozen=True)
class ExchangeStarts:
    """Starts from which several objects could be the target."""

    poses: Floats
    """(N, 3) x, y in metres and yaw in radians."""
    choices: Bools
    """(N, K) whether each of the K objects that were requested could be the target."""

    def of(self, column: int) -> ExchangeStarts:
        """Returns the starts from which one object could be the target."""
        rows = self.choices[:, column]
        return ExchangeStarts(self.poses[rows], self.choices[rows])


@dataclass(frozen=True)
class _Surroundings:
    """Objects of one category as seen from the points of the lattice."""

    ids: tuple[int, ...]
    """Ids of the K objects."""
    points: Floats
    """(P, 2) points with at least two objects in range, metres."""
    distance: Floats
    """(P, K) distances by the success measure, metres; infinite for an object that no line of sight reaches."""
    bearing: Floats
    """(P, K) directions to the centroids, radians."""
    is_apart: Bools
    """(K, K) pairs of different objects whose success regions have no point in common."""


class ClearSurvey:
    """Shares of the starts for one category from which an object is in view, and some others of the category are not.

    Args:
        scene: compiled scene.
        graph: its scene graph.
        category: name of the category.
        fov_rad: field of view of the camera, radians.
    """

    def __init__(self, scene: CompiledScene, graph: SceneGraph, category: str, fov_rad: float) -> None:
        self._targets = [each for each in scene.info.targets if each.category == category]
        self._points = _lattice(scene, _CLEAR_STEP_M)
        numbers = np.array([graph.number_of[each.target_id] for each in self._targets])
        shape = len(self._points), len(numbers)
        places = np.indices(shape).reshape(2, -1)
        free = free_lines(graph, self._points[places[0]], numbers[places[1]])
        self._free: Bools = free.reshape(*shape, -1)
        """(P, K, 5) whether no obstacle is on each line of sight from a point to an object."""
        ends = line_ends(graph, numbers) - self._points[:, None, None]
        self._bearing: Floats = portable.arctan2(ends[..., 1], ends[..., 0])
        self._half_rad = fov_rad / 2

    def share(
        self,
        target: Target,
        others: frozenset[int],
        range_m: tuple[float, float],
        noise_rad: float,
        needs_sight: bool,
        task: TaskConfig,
    ) -> float:
        """Returns the share of the starts, 0..1, that have the target in view and none of the other objects.

        Args:
            target: an object of the category.
            others: ids of other objects of the category.
            range_m: smallest and largest distance of a start by the success measure, metres.
            noise_rad: largest angle between the heading and the direction to the target, radians.
            needs_sight: whether only starts with a line of sight to the target are counted as starts.
            task: task with the success measure.
        """
        own = self._targets.index(target)
        rest = np.array([place for place, each in enumerate(self._targets) if each.instance_id in others], np.intp)
        distance = Goal.of(target, task).distances(self._points)
        is_seen = self._free[:, own].mean(axis=-1) >= SHOWN
        is_in_range = (distance >= range_m[0]) & (distance <= range_m[1])
        rows = np.flatnonzero(is_in_range & is_seen)
        starts = len(rows) if needs_sight else int(is_in_range.sum())
        turns = np.arange(-noise_rad, noise_rad + STEP_RAD / 2, STEP_RAD)
        heading = self._bearing[rows, own, 0, None] + turns  # (rows, turns)
        bearing = self._bearing[np.ix_(rows, rest)]
        off = np.abs(np.remainder(bearing[:, None] - heading[..., None, None] + math.pi, 2 * math.pi) - math.pi)
        shows_other = (self._free[np.ix_(rows, rest)][:, None] & (off <= self._half_rad)).any(axis=(-1, -2))
        return float((~shows_other).sum()) / (starts * len(turns)) if starts else 0.0


class ExchangeSurvey:
    """Floor of a scene with what can be seen from it; computed for each category when it is needed.

    Args:
        scene: compiled scene.
        graph: its scene graph.
    """

    def __init__(self, scene: CompiledScene, graph: SceneGraph) -> None:
        self._info, self._graph = scene.info, graph
        self._points = _lattice(scene)
        self._surroundings: dict[tuple[str, str, float], _Surroundings] = {}

    def starts(
        self, among: Sequence[int], tier: Tier, least: int, heading_noise_rad: float, task: TaskConfig
    ) -> ExchangeStarts:
        """Returns the starts from which at least `least` of some objects could be the target.

        Args:
            among: ids of the objects, all of one category.
            tier: near or mid.
            least: smallest number of objects that could be the target.
            heading_noise_rad: largest angle between the heading and the direction to each of them, radians.
            task: task with the success measure.
        """
        targets = {target.instance_id: target for target in self._info.targets}
        around = self._around(targets[among[0]].category, task, heading_noise_rad)
        columns = np.array([around.ids.index(each) for each in among])
        low, high = TIER_RANGE_M[tier]
        in_range = (around.distance[:, columns] >= low) & (around.distance[:, columns] <= high)
        rows = np.flatnonzero(in_range.sum(axis=1) >= least)
        bearing = around.bearing[np.ix_(rows, columns)]
        off = np.abs(np.remainder(bearing[:, None] - _HEADINGS[:, None] + math.pi, 2 * math.pi) - math.pi)
        near = in_range[rows, None] & (off <= heading_noise_rad)  # (rows, headings, objects)
        meets = ~(around.is_apart[np.ix_(columns, columns)] | np.eye(len(columns), dtype=bool))
        # a product of matrices is many times faster than a logical product over all pairs, and counts exactly
        choices = near & (near.astype(np.float32) @ meets.astype(np.float32) == 0)
        place, heading = np.nonzero(choices.sum(axis=-1) >= least)
        poses = np.column_stack([around.points[rows[place]], _HEADINGS[heading]])
        return ExchangeStarts(poses, choices[place, heading])

    def _around(self, category: str, task: TaskConfig, heading_noise_rad: float) -> _Surroundings:
        key = category, task.model_dump_json(), heading_noise_rad
        if key not in self._surroundings:
            targets = [each for each in self._info.targets if each.category == category]
            self._surroundings[key] = self._look_around(targets, task, heading_noise_rad)
        return self._surroundings[key]

    def _look_around(self, targets: Sequence[Target], task: TaskConfig, heading_noise_rad: float) -> _Surroundings:
        goals = [Goal.of(each, task) for each in targets]
        is_apart = np.array([[one is not two and one.is_disjoint(two) for two in goals] for one in goals])
        away = np.array([each.centroid_m[:2] for each in targets]) - self._points[:, None]
        reach = np.array([max(each.size_m[:2]) for each in targets])
        close = np.hypot(away[..., 0], away[..., 1]) <= _FARTHEST_M + reach
        distance: Floats = np.full(close.shape, np.inf)
        for place, goal in enumerate(goals):
            distance[close[:, place], place] = goal.distances(self._points[close[:, place]])
        bearing: Floats = portable.arctan2(away[..., 1], away[..., 0])
        # lines of sight take most of the time, so they are traced only where two objects could be in the image
        rows = np.flatnonzero(_have_pair(distance, bearing, is_apart, heading_noise_rad))
        points, distance, bearing = self._points[rows], distance[rows], bearing[rows]
        numbers = np.array([self._graph.number_of[each.target_id] for each in targets])
        row, column = np.nonzero(distance <= _FARTHEST_M)
        is_hidden = ~have_sight(self._graph, points[row], numbers[column])
        distance[row[is_hidden], column[is_hidden]] = np.inf
        ids = tuple(each.instance_id for each in targets)
        return _Surroundings(ids, points=points, distance=distance, bearing=bearing, is_apart=is_apart)


def _have_pair(distance: Floats, bearing: Floats, is_apart: Bools, heading_noise_rad: float) -> Bools:
    """Returns whether two objects (of K) that are apart are in the range of one tier and of one heading at points (P,).

    Args:
        distance: (P, K) distances, metres.
        bearing: (P, K) directions, radians.
        is_apart: (K, K) pairs of objects that are apart.
        heading_noise_rad: largest angle between a heading and the direction to an object, radians.
    """
    has_pair = np.zeros(len(distance), bool)
    ranges = [TIER_RANGE_M[tier] for tier in (Tier.NEAR, Tier.MID)]
    for one, two in zip(*np.nonzero(np.triu(is_apart)), strict=True):
        turn = np.remainder(bearing[:, one] - bearing[:, two] + math.pi, 2 * math.pi) - math.pi
        pair = distance[:, [one, two]]
        is_in_range = np.any([((pair >= low) & (pair <= high)).all(axis=1) for low, high in ranges], axis=0)
        has_pair |= is_in_range & (np.abs(turn) <= 2 * heading_noise_rad)
    return has_pair


def _lattice(scene: CompiledScene, step_m: float = STEP_M) -> Floats:
    """Returns the points (P, 2) of the lattice on the connected floor, metres."""
    resolution_m = scene.info.grid_resolution_m
    step = max(1, round(step_m / resolution_m))
    first = step // 2
    rows, columns = np.nonzero(scene.reachable[first::step, first::step])
    cells = np.column_stack([columns, rows]).astype(np.float64) * step + first + 0.5
    return np.asarray(np.asarray(scene.info.grid_origin_m) + cells * resolution_m)
