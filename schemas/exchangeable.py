"""Finds the objects that could be the target of an episode, judging by the image at its start.

The worker draws the target from these objects; validation and statistics find the objects again. Pure functions; they
read no file.

Design: docs/design/language.md#the-target-is-drawn-from-exchangeable-objects.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from schemas.instruction.referents import ids_in_view
from schemas.job import Job
from schemas.measure import Goal
from schemas.scene import SceneInfo, Target
from schemas.terms import TIER_RANGE_M


def candidates_of(job: Job, info: SceneInfo) -> tuple[Target, ...]:
    """Returns the targets that an episode may have, the planned one first; there are others only if the target is
    drawn at the start."""
    planned = info.target(job.target_id)
    if job.choice is None:
        return (planned,)
    among = set(job.choice.among)
    return (planned, *(each for each in info.targets if each.instance_id in among and each != planned))


def exchangeable_targets(
    job: Job, candidates: Sequence[Target], start: tuple[float, float, float], ids: NDArray[np.uint16]
) -> tuple[Target, ...]:
    """Returns the candidates that could be the target of an episode from its start, in the order of their ids.

    Such an object is in view, its distance and direction are allowed in the tier, and its success region does not
    overlap with that of any other candidate that meets these conditions.

    Args:
        job: job of the episode, in the near or mid tier.
        candidates: see `candidates_of`.
        start: x, y in metres and yaw in radians of base_link at rest.
        ids: (S, S) instance ids of the image at the start.
    """
    shown = ids_in_view(ids, job.gains.min_mask_px)
    near = [each for each in startable_targets(job, candidates, start) if each.instance_id in shown]
    exchangeable = [each for each, apart in zip(near, _count_apart(job, near), strict=True) if apart == len(near) - 1]
    return tuple(sorted(exchangeable, key=lambda each: each.instance_id))


def may_exchange(job: Job, candidates: Sequence[Target], start: tuple[float, float, float], least: int) -> bool:
    """Returns whether `exchangeable_targets` could return at least `least` candidates for some image at this start."""
    near = startable_targets(job, candidates, start)
    return sum(apart >= least - 1 for apart in _count_apart(job, near)) >= least


def _count_apart(job: Job, targets: Sequence[Target]) -> list[int]:
    """Returns, for each target, the number of other targets whose success region does not overlap with its own."""
    goals = [Goal.of(each, job.task) for each in targets]
    return [sum(goal is not other and goal.is_disjoint(other) for other in goals) for goal in goals]


def startable_targets(job: Job, candidates: Sequence[Target], start: tuple[float, float, float]) -> list[Target]:
    """Returns the candidates whose distance and direction from a start fit the job's tier, near or mid."""
    x, y, yaw = start
    low, high = TIER_RANGE_M[job.tier]
    startable = []
    for each in candidates:
        bearing = math.atan2(each.centroid_m[1] - y, each.centroid_m[0] - x)
        is_ahead = abs(math.remainder(bearing - yaw, 2 * math.pi)) <= job.spawn.heading_noise_rad
        if is_ahead and low <= Goal.of(each, job.task).distance(x, y) <= high:
            startable.append(each)
    return startable
