"""Compares the recorded rollout statistics, geodesic distance and path with the poses; checks the success criterion.

Reads no file.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator, Mapping

import numpy as np
from numpy.typing import NDArray

from schemas.bundle import EpisodeArrays
from schemas.episode import EpisodeMeta
from schemas.errors import WorldError
from schemas.measure import Goal, TrackMeasure, hold_steps_of, measure_track
from schemas.terms import TIER_RANGE_M, EndReason, ExpertName
from schemas.tokens import tokens_of

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


DISTANCE_SLACK_M = 1e-6
"""Tolerance between recorded and recomputed distances, metres; both use the same formula on the poses."""
POSE_SLACK = 1e-6
"""Tolerance between the recorded spawn pose and pose 0, metres and radians; both use the same formula."""
SPEED_SLACK_MPS = 1e-3
"""Tolerance between measured speed and speed of the recorded poses, m/s. At 50 m, float32 poses of
format 1 have a resolution of 4e-6 m, which is multiplied by 60 Hz."""
RADIUS_SLACK_M = 1e-5
"""Tolerance between distances of float64 and of float32 poses (format 1), metres."""


def rollout_findings(meta: EpisodeMeta, arrays: EpisodeArrays) -> list[str]:
    """Returns the differences between recorded and recomputed statistics and violations of the success criterion."""
    track = measure_track(arrays.poses, meta.target_centroid_m, meta.target_footprint_m)
    return [
        *_statistics_findings(meta, track, len(arrays.poses)),
        *_surface_findings(meta, track),
        *_goal_findings(meta, track, arrays.poses),
        *_contact_findings(meta),
        *_token_findings(arrays),
    ]


def visibility_findings(meta: EpisodeMeta, target_pixels: Mapping[int, int]) -> list[str]:
    """Returns a finding if the recorded visibility of the target contradicts the id images.

    Args:
        meta: metadata of the episode.
        target_pixels: number of pixels of the target by step, in all frames or in some.
    """
    seen = sum(pixels >= meta.job.gains.min_mask_px for pixels in target_pixels.values())
    recorded, most = meta.rollout.steps_visible, meta.rollout.num_steps - len(target_pixels) + seen
    if recorded is None or seen <= recorded <= most:
        return []
    return [f"steps_visible {recorded}, but {seen} of {len(target_pixels)} examined frames show the target"]


def arrival_findings(meta: EpisodeMeta, pixels: int) -> list[str]:
    """Returns the differences between the recorded view of the target at the end, the plan and the last frame.

    Args:
        meta: metadata of the episode.
        pixels: number of pixels of the target in the last frame.
    """
    least = meta.job.gains.min_mask_px
    at_end = pixels >= least
    findings = []
    if meta.rollout.target_in_view not in (at_end, None):
        shown = f"the last frame shows {pixels} pixels of the target; a target in view has at least {least} pixels"
        findings.append(f"target_in_view {meta.rollout.target_in_view}, but {shown}")
    if meta.job.demonstration.target_in_view and not at_end:
        findings.append(f"the last frame shows {pixels} pixels of the target, the plan requires {least}")
    return findings


def _statistics_findings(meta: EpisodeMeta, track: TrackMeasure, frames: int) -> list[str]:
    rollout = meta.rollout
    names = ("spawn_dist_m", "trajectory_length_m", "final_ne_m", "final_ne_3d_m", "min_ne_m")
    findings = [
        f"{name} is {getattr(rollout, name):.6f}, but the poses give {getattr(track, name):.6f} m"
        for name in names
        if not abs(getattr(rollout, name) - getattr(track, name)) <= DISTANCE_SLACK_M
    ]
    counts = {"collision_count": rollout.collision_count, "steps_visible": rollout.steps_visible}
    findings += [
        f"{name} is {count}, but the episode has {frames} steps"
        for name, count in counts.items()
        if (count or 0) > frames
    ]
    if frames > meta.job.task.max_steps:
        findings.append(f"num_steps {frames} is more than the job's max_steps {meta.job.task.max_steps}")
    return findings


def _surface_findings(meta: EpisodeMeta, track: TrackMeasure) -> list[str]:
    """Compares the recorded distances to the footprint with the poses; older versions record no such distances."""
    findings = []
    for name in ("spawn_surface_m", "final_surface_m"):
        recorded, measured = getattr(meta.rollout, name), getattr(track, name)
        if recorded is None and measured is None:
            continue
        if recorded is None or measured is None or not abs(recorded - measured) <= DISTANCE_SLACK_M:
            findings.append(f"{name} is {recorded}, but the poses and the footprint give {measured}")
    return findings


def _contact_findings(meta: EpisodeMeta) -> list[str]:
    limit, steps = meta.job.demonstration.max_contact_steps, meta.rollout.collision_count
    if limit is None or steps <= limit:
        return []
    return [f"collision_count is {steps}, but the plan allows at most {limit}"]


def _goal_findings(meta: EpisodeMeta, track: TrackMeasure, poses: NDArray[np.float64]) -> list[str]:
    try:
        goal = Goal.of_episode(meta)
    except WorldError as error:
        return [str(error)]
    distances = goal.distances(poses[:, :2])
    if meta.job.is_false_premise:  # a false premise has no target, so the goal is the start
        distances = np.linalg.norm(poses[:, :2] - poses[0, :2], axis=1)
    return [*_spawn_findings(meta, track, goal), *_success_findings(meta, distances, poses)]


def _spawn_findings(meta: EpisodeMeta, track: TrackMeasure, goal: Goal) -> list[str]:
    off = math.dist(meta.rollout.spawn_pose[:2], track.spawn_pose[:2])
    turned = abs(math.remainder(meta.rollout.spawn_pose[2] - track.spawn_pose[2], 2 * math.pi))
    findings = []
    if not (off <= POSE_SLACK and turned <= POSE_SLACK):
        findings.append(f"spawn_pose is {off:.6f} m and {turned:.6f} rad away from pose 0")
    if meta.rollout.spawn_draws > meta.job.spawn.physics_draws:
        findings.append(
            f"spawn_draws is {meta.rollout.spawn_draws}, but the job allows at most {meta.job.spawn.physics_draws}"
        )
    low, high = TIER_RANGE_M.get(meta.job.tier, (0.0, math.inf))
    slack = meta.job.spawn.max_displacement_m  # the warm-up may move the robot this far from the sampled pose
    distance = goal.distance(*track.spawn_pose[:2])
    if not low - slack <= distance <= high + slack:
        findings.append(f"spawn distance {distance:.3f} m is outside tier {meta.job.tier} ({low:g}-{high:g} m)")
    return findings


def _success_findings(meta: EpisodeMeta, distances: NDArray[np.float64], poses: NDArray[np.float64]) -> list[str]:
    """Returns how an episode violates the success rule, given the distances of all poses to the goal, metres."""
    task, steps = meta.job.task, hold_steps_of(meta.job, meta.job.task)
    if meta.rollout.end_reason is not EndReason.SUCCESS:
        return [f"end_reason is {meta.rollout.end_reason}; only successes are archived"]
    if len(poses) <= steps:
        return [f"{len(poses)} frames are too few for a success, which needs {steps} stationary steps"]
    findings = []
    last = poses[-steps - 1 :, :2]  # one more pose, because a speed is computed from two poses
    farthest = float(distances[-steps:].max())
    if not farthest <= task.success_radius_m + RADIUS_SLACK_M:
        findings.append(
            f"no success: {farthest:.4f} m from the target during the last {steps} steps; the success radius is "
            f"{task.success_radius_m:g} m"
        )
    speed = float(np.linalg.norm(np.diff(last, axis=0), axis=1).max()) * task.control_hz
    if not speed < task.stationary_speed_mps + SPEED_SLACK_MPS:
        findings.append(
            f"no success: {speed:.4f} m/s during the last {steps} steps; a stationary robot is slower "
            f"than {task.stationary_speed_mps:g} m/s"
        )
    return findings


def _token_findings(arrays: EpisodeArrays) -> list[str]:
    wrong = np.flatnonzero((tokens_of(arrays.actions_continuous) != arrays.actions_tokens).any(axis=1))
    if len(wrong) == 0:
        return []
    t = int(wrong[0])
    action, token = arrays.actions_continuous[t].tolist(), arrays.actions_tokens[t].tolist()
    return [f"actions_tokens: {token} is not the nearest grid point of {action} at step {t}; {len(wrong)} steps differ"]
