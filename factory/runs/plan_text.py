"""Describes a plan as tables, text and JSON data, with the expected share of far starts around a corner.

Simulates nothing.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

from coordinator.expansion.catalog import Catalog
from coordinator.expansion.cells import cells
from coordinator.expansion.draw import PlannedJob, expand, to_job
from coordinator.expansion.nearest import NearestPlan
from coordinator.expansion.plan_file import shrink
from coordinator.expansion.summary import MOST_SUMMARISED, PlanSummary
from factory.runs.estimate import describe_estimate, estimate_run
from factory.support.terminal import print_table, print_text
from schemas.instruction.templates import TEMPLATES
from schemas.language.compose import Composer
from schemas.language.language_file import LanguageSpec
from schemas.layouts import unseen_layouts
from schemas.plan import Plan, ScenePlan
from schemas.scene import read_geometry
from schemas.terms import Tier, family_of
from workers.planning import is_way_straight

if TYPE_CHECKING:
    from workers.sim.context import LoadedScene

_MOST_TARGETS = 12
"""Largest number of targets of a scene whose distances along the floor are computed; each takes 0.1 s."""


def print_plan(plan: Plan) -> None:
    """Prints the facts, scenes, categories and quotas of a plan."""
    facts = f"{plan.episodes} episodes of {plan.record}, seed {plan.seed}, expert {plan.expert}, run {plan.run}"
    print_text(f"plan {plan.name}: {facts}" + ("" if plan.rig is None else f", {plan.view.describe()}"))
    for scene in plan.scenes:
        seen, held_out = scene.categories
        print_text(f"  {scene.name}: seen {', '.join(seen)}; held-out {', '.join(held_out) or 'none'}")
        if scene.layouts is not None:
            print_text(f"    {_describe_layouts(plan, scene)}")
    print_cells(plan)
    for line in describe_estimate(plan, estimate_run(plan)):
        print_text(line)


def print_cells(plan: Plan) -> None:
    """Prints the quotas of a plan."""
    rows = [(row["scene"], row["split"], *(row[tier] for tier in Tier), row["episodes"]) for row in cell_rows(plan)]
    print_table("", ("scene", "split", *(str(tier) for tier in Tier), "episodes"), rows)


def cell_rows(plan: Plan) -> list[dict[str, Any]]:
    """Returns the quotas of a plan as JSON data: a row for each scene and split."""
    rows = []
    for scene in plan.scenes:
        quota = cells(plan, scene)
        for split in plan.splits_of(scene):
            counts: dict[str, Any] = {str(tier): quota.get((split, tier), 0) for tier in Tier}
            if sum(counts.values()):
                rows.append({"scene": scene.name, "split": str(split), **counts, "episodes": sum(counts.values())})
    return rows


def content_data(content: PlanSummary) -> dict[str, Any]:
    """Returns the categories, templates and ambiguity of a plan as JSON data."""
    total = content.episodes
    return {
        "episodes": total,
        "categories": [{"category": k, "episodes": n, "share": n / total} for k, n in content.categories.items()],
        "top_three_share": content.top_three_share,
        "templates": [
            {"template_id": k, "text": TEMPLATES.get(k, "written at the start"), "episodes": n, "share": n / total}
            for k, n in content.templates.items()
        ],
        "distractors": {str(others): count for others, count in content.distractors.items()},
        "ambiguous_share": content.ambiguous / total,
        "shown_alone_share": content.shown_alone / total,
    }


def print_content(plan: Plan, content: PlanSummary) -> None:
    """Prints the categories, templates and ambiguity of a plan."""
    total = content.episodes
    if total < plan.episodes:
        print_text(f"categories, templates and ambiguity of the plan reduced to {total} episodes:")
    rows = [(name, count, 100 * count / total) for name, count in content.categories.items()]
    print_table("", ("category", "episodes", "share %"), rows)
    print_text(f"share of the three most frequent categories: {content.top_three_share:.1%}")
    if plan.language is not None:
        _print_language(plan.language, content)
        return
    texts = [(name, TEMPLATES[name], count) for name, count in content.templates.items()]
    print_table("", ("template", "text", "episodes"), texts)
    print_text(
        f"expected ambiguity: {content.ambiguous / total:.1%} of the instructions fit several objects of the scene\n"
        f"  ({content.shown_alone / total:.1%} with a start that shows only the target, "
        f"{(content.ambiguous - content.shown_alone) / total:.1%} without)"
    )


def print_layout_categories(episodes: Mapping[str, int]) -> None:
    """Prints the number of episodes of each category in the layouts of a plan."""
    if not episodes:
        print_text(
            'categories of the layouts: not known yet, because balance = "instances" draws evenly over the objects; '
            'balance = "categories" gives each category the same number of episodes'
        )
        return
    total = sum(episodes.values())
    rows = [(name, count, 100 * count / total) for name, count in episodes.items()]
    print_table("categories of the layouts", ("category", "episodes", "share %"), rows)


def print_corners(shares: Mapping[str, float]) -> None:
    """Prints the shares of `corner_shares`."""
    listed = ", ".join(f"{name} {share:.0%}" for name, share in shares.items())
    print_text(f"far starts without a free straight line to the target, expected: {listed}")


def print_nearest(plan: Plan, nearest: NearestPlan, mistakes: Sequence[str]) -> None:
    """Prints the nearest feasible plan and its differences from a plan.

    Args:
        plan: requested plan.
        nearest: nearest feasible plan.
        mistakes: reasons why the scenes do not support `plan`.
    """
    if not mistakes or nearest.plan is None:
        print_text(f"plan {plan.name} is feasible without changes: {plan.episodes} episodes")
        return
    for line in mistakes:
        print_text(f"impossible: {line}")
    print_text(
        f"nearest plan: {nearest.plan.episodes} of {plan.episodes} episodes, {nearest.moved} of them moved to another "
        "split or tier"
    )
    for line in nearest.changes:
        print_text(f"  {line}")
    print_cells(nearest.plan)


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
    from workers.sim.context import prepare_scene  # loads PyBullet, which a plan on paper does not need

    scene = prepare_scene(read_geometry(catalog[far[0].episode.scene].path))
    number = Counter(planned.episode.target_id for planned in far)
    first = {planned.episode.target_id: planned for planned in reversed(far)}
    weighted = [
        (count, share)
        for name, count in number.most_common(_MOST_TARGETS)
        if (share := _share_of_target(plan, catalog, first[name], scene)) is not None
    ]
    return sum(count * share for count, share in weighted) / sum(count for count, _ in weighted) if weighted else None


def _share_of_target(plan: Plan, catalog: Catalog, planned: PlannedJob, scene: LoadedScene) -> float | None:
    from workers.sim.spawn import surveyed_points

    job = to_job(plan, catalog, planned, attempt=1)
    target = scene.compiled.info.target(job.target_id)
    points = surveyed_points(job, target, scene)
    bent = [not is_way_straight(scene.grid, point, target, job.task) for point in points]
    return sum(bent) / len(bent) if bent else None


def _describe_layouts(plan: Plan, scene: ScenePlan) -> str:
    """Returns the layouts of a family in one line, such as `6 layouts home_00000 to home_00005, 4 episodes each`."""
    parts = [part for part in plan.parts if family_of(part.name) == scene.name]
    counts = sorted({part.episodes for part in parts})
    each = f"{counts[0]} to {counts[-1]}" if len(counts) > 1 else f"{counts[0]}"
    unseen = unseen_layouts(scene, plan.splits_of(scene))
    kept = f"; the last {unseen} only for test_unseen_scene*" if unseen else ""
    return f"{len(parts)} layouts {parts[0].name} to {parts[-1].name}, {each} episodes each{kept}"


def _print_language(language: LanguageSpec, content: PlanSummary) -> None:
    composer = Composer(language)
    codes = [code for code, share in language.languages.items() if share > 0]
    rows = [(code, len(composer.patterns_of(code, False)), len(composer.patterns_of(code, True))) for code in codes]
    print_table("", ("language", "sentence patterns", "held out for test_paraphrase_ood"), rows)
    fits = "the target only" if language.fit == "one" else "any of several objects"
    print_text(f"instructions fit {fits}; features: {', '.join(sorted(language.families))}")
    wanted = f", at least {language.in_view} in view at the start" if language.in_view else ""
    wanted += "; the target is drawn at the start" if language.exchangeable else ""
    listed = ", ".join(f"{others} ({count / content.episodes:.0%})" for others, count in content.distractors.items())
    print_text(f"other objects of the target's category in the scene, and share of the episodes: {listed}{wanted}")
