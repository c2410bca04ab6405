"""Estimates size and time of a run from measured episodes (docs/performance.md), and checks the disk before a start."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType

from coordinator.expansion.cells import cells
from factory.dataset.site import Site
from factory.support.text import format_bytes
from schemas.errors import WorldError
from schemas.plan import Plan
from schemas.storage.disk import free_bytes
from schemas.storage.episode_list import list_episodes
from schemas.support.shell import quoted
from schemas.terms import ExpertName, Recording, Tier

_STEPS = MappingProxyType({Tier.NEAR: 130, Tier.MID: 260, Tier.FAR: 430})
"""Mean steps of an episode by tier, of the plan `paper`."""
_FRAME_BYTES = 480_000
_STATES_BYTES, _STATES_STEP_BYTES = 8_000, 45
_FRAME_S = 0.017
"""CPU time of a frame with its simulation and its validation, seconds."""
_STATES_S = MappingProxyType({True: 0.0013, False: 0.0053})
"""CPU time of a step of a states recording, seconds, by whether the planner drives."""
_EPISODE_S, _LAYOUT_S = 0.1, 5.5
"""CPU time of the start of an episode, and of a layout, seconds."""
_LAYOUT_BYTES = 700_000
_ACCURACY = 1.6
"""Factor within which the size of a dataset was in every measurement."""


@dataclass(frozen=True)
class RunEstimate:
    """Expected size and time of a run."""

    episodes: int
    """Number of episodes."""
    bytes: dict[str, int]
    """Size of the dataset by recording, bytes; without the images of a rig."""
    core_hours: dict[str, float]
    """CPU time by recording, hours of one core."""


def estimate_run(plan: Plan) -> RunEstimate:
    """Returns the expected size and time of the episodes of a plan and of its layouts."""
    counts = dict.fromkeys(Tier, 0)
    for scene in plan.scenes:
        for (_, tier), count in cells(plan, scene).items():
            counts[tier] += count
    episodes, steps = sum(counts.values()), sum(_STEPS[tier] * count for tier, count in counts.items())
    layouts = sum(scene.layouts or 0 for scene in plan.scenes)
    states_s = steps * _STATES_S[plan.expert is ExpertName.PLANNER]
    common_s = episodes * _EPISODE_S + layouts * _LAYOUT_S
    return RunEstimate(
        episodes,
        {
            Recording.FRAMES.value: steps * _FRAME_BYTES + layouts * _LAYOUT_BYTES,
            Recording.STATES.value: episodes * _STATES_BYTES + steps * _STATES_STEP_BYTES + layouts * _LAYOUT_BYTES,
        },
        {
            Recording.FRAMES.value: (steps * _FRAME_S + common_s) / 3600,
            Recording.STATES.value: (states_s + common_s) / 3600,
        },
    )


def describe_estimate(plan: Plan, estimate: RunEstimate) -> list[str]:
    """Returns one line for each recording, with that of the plan first."""
    lines = []
    for record in sorted(Recording, key=lambda one: one is not plan.record):
        name = f"record = {record.value}" if record is plan.record else f"  --record {record.value}"
        lines.append(
            f"{name}: about {format_bytes(estimate.bytes[record.value])}, "
            f"{_format_hours(estimate.core_hours[record.value])} of one core"
        )
    return lines


def require_disk(plan: Plan, root: Path, archived: int = 0) -> None:
    """Checks that the free space of a directory can suffice for the episodes of a run; creates nothing.

    Args:
        plan: plan of the run.
        root: directory of the dataset, which need not exist.
        archived: number of episodes that it contains.

    Raises:
        WorldError: even an unusually small dataset of this plan would not fit.
    """
    estimate = estimate_run(plan)
    share = (estimate.episodes - archived) / estimate.episodes
    free = free_bytes(root)
    needed = round(estimate.bytes[plan.record.value] * share)
    if needed / _ACCURACY <= free:
        return
    fitting = int(plan.episodes * free / max(1, needed) * 0.8)
    smaller = [f"`--episodes {fitting}`"] if fitting else []
    if plan.record is Recording.FRAMES:
        size = format_bytes(round(estimate.bytes[Recording.STATES.value] * share))
        smaller.insert(0, f"`--record states`, which needs about {size} and renders the same frames when they are read")
    raise WorldError(
        f"{quoted(root)} has {format_bytes(free)} free, but {plan.episodes - archived} episodes of {plan.record.value} "
        f"need about {format_bytes(needed)}: use {', or '.join(smaller)}; or choose another --out"
    )


def count_archived(site: Site) -> int:
    return len(list_episodes(site.place).episodes)


def _format_hours(hours: float) -> str:
    return f"{hours:.2g} h" if hours >= 1 else f"{max(1, round(60 * hours))} min"
