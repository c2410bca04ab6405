"""Computes which share of the planned far starts has no free straight line to the target. Simulates nothing."""

from __future__ import annotations

from collections import Counter

from coordinator.expansion.catalog import Catalog
from coordinator.expansion.draw import PlannedJob, expand, to_job
from coordinator.expansion.plan_file import shrink
from coordinator.expansion.summary import MOST_SUMMARISED
from schemas.plan import Plan
from schemas.scene import read_geometry
from schemas.terms import Tier
from workers.planning import is_way_straight
from workers.sim.context import LoadedScene, prepare_scene
from workers.sim.spawn import surveyed_points

_MOST_TARGETS = 12
"""Largest number of targets of a scene whose distances along the floor are computed; each takes 0.1 s."""


def corner_shares(plan: Plan, catalog: Catalog) -> dict[str, float]:
    """Returns the expected share of far starts without a free straight line, 0..1, by scene.

    Scenes without far starts are omitted. The share is estimated from the `_MOST_TARGETS` most frequent targets of each
    scene. For each of these targets, all surveyed points in the range of the tier are taken as equally probable starts.
    Conditions on the start view and collision tests of the start pose are ignored.

    Args:
        plan: Plan that its scenes can fulfil.
        catalog: Scenes of the plan.
    """
    part = shrink(plan, episodes=min(plan.episodes, MOST_SUMMARISED))
    far: dict[str, list[PlannedJob]] = {}
    for planned in expand(part, catalog):
        if planned.episode.tier is Tier.FAR:
            far.setdefault(planned.episode.scene, []).append(planned)
    shares = {name: _share(part, catalog, jobs) for name, jobs in far.items()}
    return {name: share for name, share in shares.items() if share is not None}


def _share(plan: Plan, catalog: Catalog, far: list[PlannedJob]) -> float | None:
    """Returns the share for the far starts of one scene; `None` if no surveyed point is in range of its targets."""
    place = prepare_scene(read_geometry(catalog[far[0].episode.scene].path))
    number = Counter(planned.episode.target_id for planned in far)
    first = {planned.episode.target_id: planned for planned in reversed(far)}
    found = [
        (count, share)
        for name, count in number.most_common(_MOST_TARGETS)
        if (share := _share_of_target(plan, catalog, first[name], place)) is not None
    ]
    return sum(count * share for count, share in found) / sum(count for count, _ in found) if found else None


def _share_of_target(plan: Plan, catalog: Catalog, planned: PlannedJob, place: LoadedScene) -> float | None:
    job = to_job(plan, catalog, planned, attempt=1)
    target = place.scene.info.target(job.target_id)
    points = surveyed_points(job, target, place)
    bent = [not is_way_straight(place.grid, point, target, job.task) for point in points]
    return sum(bent) / len(bent) if bent else None
