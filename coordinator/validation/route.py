"""Compares the recorded geodesic distance and planned path with the poses. Reads no file."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator

from schemas.bundle import EpisodeArrays
from schemas.episode import EpisodeMeta
from schemas.errors import WorldError
from schemas.measure import Goal
from schemas.terms import ExpertName

GEODESIC_SLACK_M = 0.05
"""Tolerance of the geodesic distance, metres: one grid cell, because a path ends on a cell, not at the edge."""
START_SLACK_M = 1e-4
"""Tolerance between the path's first pose and pose 0, which is float32 in format 1, metres."""
STRIDE_M = 0.2 + 1e-6
"""Longest step between two poses of a path, metres."""


def route_findings(meta: EpisodeMeta, arrays: EpisodeArrays) -> list[str]:
    """Returns the contradictions between the recorded route, the poses and the target."""
    try:
        goal = Goal.of_episode(meta)
    except WorldError:
        return []  # `rollout_findings` reports it
    return [*_geodesic_findings(meta, arrays, goal), *_path_findings(meta, arrays, goal)]


def _geodesic_findings(meta: EpisodeMeta, arrays: EpisodeArrays, goal: Goal) -> Iterator[str]:
    geodesic = meta.route.geodesic_m
    least = goal.distance(*arrays.poses[0, :2].tolist()) - goal.radius_m
    if geodesic is not None and geodesic < least - GEODESIC_SLACK_M:
        yield f"geodesic_m {geodesic:.3f}, but the success region is {least:.3f} m away in a straight line"


def _path_findings(meta: EpisodeMeta, arrays: EpisodeArrays, goal: Goal) -> Iterator[str]:
    path = meta.route.planned
    has_planner = meta.job.expert is ExpertName.PLANNER and not meta.job.is_false_premise
    if bool(path) != has_planner:
        yield f"a path of {len(path)} poses in an episode of the {meta.job.expert} expert"
    if not path or not has_planner:
        return
    off = math.dist(path[0][:2], arrays.poses[0, :2].tolist())
    if not off <= START_SLACK_M:
        yield f"the path starts {off:.4f} m from pose 0"
    stride = max((math.dist(a[:2], b[:2]) for a, b in itertools.pairwise(path)), default=0.0)
    if not stride <= STRIDE_M:
        yield f"the path has a step of {stride:.3f} m, limit {STRIDE_M:.1f} m"
    left = goal.distance(*path[-1][:2])
    if not left <= goal.radius_m:
        yield f"the path ends {left:.3f} m from the target, success radius {goal.radius_m:g} m"
