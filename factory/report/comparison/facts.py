"""Computes means that explain the trajectory lengths of a group: start distance, detour and speed. Pure functions.

The detour of an episode is its trajectory length minus the distance by which the robot approached the target: its
start distance minus its navigation error (NE).
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass

from factory.stats.measures import deviation_of, mean_of
from schemas.dataset.rows import EpisodeSummary
from schemas.terms import Tier


@dataclass(frozen=True)
class RunFacts:
    """Means over a group of episodes, in metres and steps."""

    n: int
    spawn_m: float
    """Mean planar distance of the start from the target, metres."""
    spawn_std_m: float | None
    ne_m: float
    tl_m: float
    steps: float
    detour_m: float
    detour_std_m: float | None
    geodesic_m: float | None
    """Mean geodesic distance to the success region over the episodes that record this distance, metres."""
    tiers: dict[str, float]
    """Tier -> share, 0..1."""

    @property
    def steps_per_m(self) -> float | None:
        """Steps per metre of trajectory length."""
        return self.steps / self.tl_m if self.tl_m > 0 else None


def facts_of(episodes: Sequence[EpisodeSummary]) -> RunFacts | None:
    """Returns the means of a group, or `None` for an empty group."""
    spawn = mean_of([row.spawn_dist_m for row in episodes])
    error = mean_of([row.final_ne_m for row in episodes])
    length = mean_of([row.trajectory_length_m for row in episodes])
    steps = mean_of([row.num_steps for row in episodes])
    detours = [row.trajectory_length_m - (row.spawn_dist_m - row.final_ne_m) for row in episodes]
    detour = mean_of(detours)
    if spawn is None or error is None or length is None or steps is None or detour is None:
        return None
    found = Counter(str(row.spawn_tier) for row in episodes)
    return RunFacts(
        n=len(episodes),
        spawn_m=spawn,
        spawn_std_m=deviation_of([row.spawn_dist_m for row in episodes]),
        ne_m=error,
        tl_m=length,
        steps=steps,
        detour_m=detour,
        detour_std_m=deviation_of(detours),
        geodesic_m=mean_of([row.geodesic_m for row in episodes if row.geodesic_m is not None]),
        tiers={str(tier): found[tier] / len(episodes) for tier in Tier},
    )
