"""Explains differences from the paper in one or two sentences with numbers. Pure functions.

The detour of an episode is its trajectory length minus the distance by which the robot approached the target: its
start distance minus its navigation error (NE).
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass

from factory.report.data import ReportInput
from factory.stats import paper
from factory.stats.measures import deviation_of, mean_of
from factory.stats.rollouts import ALL
from factory.stats.statistics import AttemptRow, Published, Statistics
from schemas.dataset.rows import EpisodeSummary
from schemas.instruction.templates import needs_colour, say_category
from schemas.terms import ExpertName, Screening, Split, Tier


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
    tiers = Counter(str(row.spawn_tier) for row in episodes)
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
        tiers={str(tier): tiers[tier] / len(episodes) for tier in Tier},
    )


def explain_length(facts: RunFacts, published_tl_m: float, published_ne_m: float) -> str:
    """Explains the mean TL as start distance - NE + detour. The start distance of the paper is estimated: TL + NE."""
    implied = published_tl_m + published_ne_m
    return (
        f"The mean start distance is {facts.spawn_m:.2f} m, and {implied:.2f} m in the paper (TL + NE, which assumes "
        f"straight trajectories); the difference is {_signed(facts.spawn_m - implied)} m. The mean trajectory is "
        f"{abs(facts.detour_m):.2f} m {'longer' if facts.detour_m >= 0 else 'shorter'} than the straight line."
    )


def explain_mix(facts: RunFacts) -> str:
    """Lists the shares of the tiers."""
    return " Tiers: " + ", ".join(f"{tier} {_percent(share)}" for tier, share in facts.tiers.items()) + "."


def explain_standardised(statistics: Statistics) -> str:
    """Returns the mean TL weighted by the paper's shares of the tiers."""
    means = {row.group: row.tl_mean_m for row in statistics.tiers}
    total = 0.0
    for tier, published in paper.TIERS.items():
        mean = means.get(tier)
        if mean is None or published.share is None:
            return f" There are no {tier} episodes, so the mean cannot be weighted by the paper's tiers."
        total += published.share * mean
    return f" Weighted by the paper's tiers, the mean is {total:.2f} m."


def explain_steps(facts: RunFacts, published: Published) -> str:
    """Explains the mean number of steps by the mean trajectory length and the steps per metre."""
    here = facts.steps_per_m
    text = f"Mean TL {facts.tl_m:.2f} m" + (f" at {here:.1f} steps per metre" if here else "")
    if published.tl_mean_m is None:
        return f"{text}."
    if published.steps_mean is None:
        return f"{text}; in the paper {published.tl_mean_m:.2f} m."
    steps_per_m = published.steps_mean / published.tl_mean_m
    return f"{text}; in the paper {published.tl_mean_m:.2f} m at {steps_per_m:.1f} steps per metre."


def explain_floor(material: ReportInput, scene: str) -> str:
    """Describes the size of a scene and its ratio of geodesic to straight distance."""
    facts = facts_of(material.of(scene))
    if scene == ALL or facts is None or scene not in material.maps:
        return ""
    text = f" {material.maps[scene].free_area_m2:.0f} m² of free floor"
    straight = facts.spawn_m - material.statistics.success_radius_m
    if facts.geodesic_m is not None and straight > 0:
        text += f"; the shortest path is {facts.geodesic_m / straight:.2f} times the straight line"
    return f"{text}."


def explain_error(statistics: Statistics) -> str:
    """Names the scene with the largest deviation in NE."""
    rows = [row for row in statistics.navigation_error if row.group != ALL and row.mean is not None]
    published = paper.NAVIGATION_ERROR.ne_mean_m or 0.0
    worst = max(rows, key=lambda row: abs((row.mean or 0.0) - published))
    lowest, highest = worst.quantiles.get("p00", 0.0), worst.quantiles.get("p100", 0.0)
    text = (
        f"The largest difference is in {_scene(worst.group)}: mean {worst.mean:.3f} m, "
        f"range {lowest:.3f} to {highest:.3f} m (N {worst.n})"
    )
    if statistics.success_radius_m != 1:
        text += f"; the success radius is {statistics.success_radius_m:g} m"
    return f"{text}."


def explain_planned(statistics: Statistics, group: Tier | Split, planned: float, published_n: int | None) -> str:
    """Explains a share by the plan: in a plan with few episodes, the quotas only approximate the planned shares."""
    if not statistics.complete:
        state = f"{statistics.episodes} of {statistics.planned} generated so far"
    else:
        exact = all(cell.planned == cell.archived for cell in statistics.cells)
        state = "generated as planned" if exact else "not every cell has its planned number"
    counted = "" if published_n is None else f"; the paper counts {published_n} of {paper.OVERALL.n} successes"
    mine = sum(cell.planned for cell in statistics.cells if group in {cell.tier, cell.split})
    quota = _percent(mine / max(1, sum(cell.planned for cell in statistics.cells)))
    cut = "" if quota == _percent(planned) else f" ({quota} after rounding to its {statistics.planned} episodes)"
    return f"The plan requests {_percent(planned)}{cut}; {state}{counted}."


def explain_largest(statistics: Statistics) -> str:
    """Lists the most frequent categories."""
    names = [f"{say_category(row.group)} {_percent(row.share or 0)}" for row in statistics.categories[:3]]
    return f"In this dataset: {', '.join(names)}; in the paper: monitor 29 %, rack 22 %, crate 11 %."


def explain_category_share(material: ReportInput, category: str) -> str:
    """Explains the share of a category by the share of the scenes that contain it."""
    homes = {row.scene for row in material.episodes if row.target_category == category}
    if not homes:
        offered = [scene.name for scene in material.meta.plan.scenes if category in sum(scene.categories, ())]
        where = f"it exists in {', '.join(map(_scene, offered))}" if offered else "no scene of the plan has it"
        return f"None of {len(material.episodes)} episodes has this category; {where}."
    here = sum(row.scene in homes for row in material.episodes) / len(material.episodes)
    counted = [scene.n for name, scene in paper.SCENES.items() if name in homes and scene.n is not None]
    there = sum(counted) / (paper.OVERALL.n or 1)
    text = f"Scenes with this category contain {_percent(here)} of the episodes, and {_percent(there)} in the paper"
    drawn = "uniformly over instances" if material.meta.plan.balance == "instances" else "by category first"
    return f"{text}; targets are drawn {drawn}."


def explain_correlation(facts: RunFacts | None) -> str:
    """Explains r by the standard deviations of start distances and detours."""
    if facts is None or facts.spawn_std_m is None or facts.detour_std_m is None:
        return ""
    return (
        f"The standard deviation is {facts.detour_std_m:.2f} m for detours and {facts.spawn_std_m:.2f} m for start "
        "distances; r is close to 1 if detours vary much less than start distances."
    )


def explain_slope(statistics: Statistics) -> str:
    """Lists the slopes by tier."""
    parts = [
        f"{fit.group} {fit.slope:.2f} (N {fit.n})"
        for fit in statistics.correlation
        if fit.slope is not None and fit.group in set(Tier)
    ]
    return f"Slopes by tier: {', '.join(parts)}." if parts else ""


def explain_colours(material: ReportInput) -> str:
    """Explains the use of colour templates."""
    coloured = sum(row.colour != "unknown" for row in material.episodes)
    used = len({row.template_id for row in material.episodes if needs_colour(row.template_id)})
    return (
        f"Colours come from the materials of the scenes: {coloured} of {len(material.episodes)} targets have a colour, "
        f"so that {used} templates with a colour occur, which the paper could not use."
    )


def explain_success(material: ReportInput, row: AttemptRow) -> str:
    """Explains the success rate by the reasons of failures and the choice of starts."""
    lost = Counter(row.reasons)
    reasons = ", ".join(f"{count} {reason}" for reason, count in sorted(lost.items())) or "none failed"
    text = f"{row.success.count} of {row.attempts} attempts succeeded ({reasons})."
    spawn, expert = material.meta.plan.spawn_of(row.group), material.meta.plan.expert
    if expert is ExpertName.PLANNER:
        return f"{text} The planner avoids obstacles at which the paper's controller stalls."
    if not spawn.needs_free_line:
        near = ", but near and mid starts must see the target" if spawn.screening is Screening.SIGHT else ""
        return (
            f"{text} Starts are drawn without a check for obstacles, as in the paper{near}; the walls and racks of "
            "these scenes differ from the paper's, so they block other trajectories."
        )
    return (
        f"{text} Starts are drawn until the straight line to the success circle has a clearance of "
        f"{spawn.approach_clearance_m:.2f} m (screening {spawn.screening}); the paper draws starts at random and "
        "discards failures."
    )


def _signed(value: float) -> str:
    return f"{value:+.2f}".replace("-", "−")


def _percent(share: float) -> str:
    return f"{100 * share:.0f} %"


def _scene(name: str) -> str:
    return name.replace("_", " ")
