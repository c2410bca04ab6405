"""Determines which targets of a scene have starts in the far tier, for the smallest far distance that a plan permits.

A package records the tiers for the default distance. Without this module, a plan that permits smaller far
distances would be refused in a small room. A package that records all distances would need a new format, and the
digest of every scene would change. Reads the surveyed points of a package, and writes nothing.
"""

from __future__ import annotations

import functools
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from coordinator.expansion.catalog import SceneEntry
from schemas.config import TaskConfig
from schemas.measure import Goal
from schemas.plan import Plan
from schemas.scene import Target, read_survey
from schemas.terms import FAR_FLOOR_M, SuccessMeasure, Tier

_FIELDS = {
    SuccessMeasure.CENTROID: ("straight_tiers", "connected_tiers"),
    SuccessMeasure.SURFACE: ("surface_straight_tiers", "surface_connected_tiers"),
}


def with_far_tiers(plan: Plan, entry: SceneEntry) -> SceneEntry:
    """Returns the scene with the far tier of its targets according to `spawn.far_floor_m` of a plan."""
    least_m = plan.spawn.far_floor_m[0]
    if least_m == FAR_FLOOR_M[0]:
        return entry
    return _adapted(entry, plan.task, least_m)


@functools.lru_cache(maxsize=16)
def _adapted(entry: SceneEntry, task: TaskConfig, least_m: float) -> SceneEntry:
    with entry.path.open("rb") as file:
        spawns, sees = read_survey(file)
    targets = tuple(
        _target(target, task, spawns, sees[:, column] > 0, least_m) for column, target in enumerate(entry.info.targets)
    )
    return replace(entry, known=entry.info.model_copy(update={"targets": targets}))


def _target(
    target: Target, task: TaskConfig, spawns: NDArray[np.float32], sees: NDArray[np.bool_], least_m: float
) -> Target:
    straight, connected = (getattr(target, field) for field in _FIELDS[task.success])
    if not connected:
        return target  # the target is not reachable, or has no footprint, which the success measure needs
    # the planar distance suffices, because the path along the floor is at least as long
    is_far = Goal.of(target, task).distances(spawns) >= least_m
    # the package records the far tier for the default limit; a start beyond it is also beyond a shorter limit
    was_far = least_m < FAR_FLOOR_M[0] and Tier.FAR in straight
    changes = {"straight": bool((is_far & sees).any()) or was_far, "connected": bool(is_far.any())}
    tiers = [
        tuple(tier for tier in Tier if (holds if tier is Tier.FAR else tier in old))
        for old, holds in zip((straight, connected), changes.values(), strict=True)
    ]
    return target.model_copy(update=dict(zip(_FIELDS[task.success], tiers, strict=True)))
