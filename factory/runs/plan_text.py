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
from coordinator.expansion.sentences import LanguageForecast
from coordinator.expansion.summary import MOST_SUMMARISED, OfferRow, PlanSummary
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
    """Prints the categories of a plan and, without a language block, its templates and their ambiguity."""
    total = content.episodes
    if total < plan.episodes:
        print_text(f"content of {total} of {plan.episodes} episodes, those of built scenes, at most {MOST_SUMMARISED}:")
    rows = [(name, count, 100 * count / total) for name, count in content.categories.items()]
    print_table("", ("category", "episodes", "share %"), rows)
    print_text(f"share of the three most frequent categories: {content.top_three_share:.1%}")
    if plan.language is not None:
        return
    texts = [(name, TEMPLATES[name], count) for name, count in content.templates.items()]
    print_table("", ("template", "text", "episodes"), texts)
    print_text(
        f"expected ambiguity: {content.ambiguous / total:.1%} of the instructions fit several objects of the scene\n"
        f"  ({content.shown_alone / total:.1%} with a start that shows only the target, "
        f"{(content.ambiguous - content.shown_alone) / total:.1%} without)"
    )


def print_samples(plan: Plan, samples: Sequence[str]) -> None:
    """Prints examples of the instructions of a plan, if there are any."""
    if not samples:
        return
    is_verified = plan.language is not None
    kind = "verified; each fits the target only" if is_verified else "templates; they may fit several objects"
    print_text(f"instructions ({kind}), for example:")
    for text in samples:
        print_text(f"  {text}")


def print_built_layouts(plan: Plan, catalog: Catalog) -> None:
    """Prints how many layouts of each family are built, which the numbers of scenes and objects count."""
    for scene in plan.scenes:
        if scene.layouts is not None:
            built = sum(family_of(name) == scene.name for name in catalog if name != scene.name)
            print_text(f"layouts of {scene.name} that are built and counted: {built} of {scene.layouts}")


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


def print_language(
    plan: Plan, language: LanguageSpec, content: PlanSummary | None, forecast: LanguageForecast | None
) -> None:
    """Prints sentence patterns and features of a plan, asked and expected, and its ambiguity.

    Args:
        plan: plan with the language block.
        language: language block of the plan.
        content: summary of the plan; `None` if its scenes are not built.
        forecast: expected sentences; `None` if its scenes are not built.
    """
    composer = Composer(language)
    codes = [code for code, share in language.languages.items() if share > 0]
    rows = [(code, len(composer.patterns_of(code, False)), len(composer.patterns_of(code, True))) for code in codes]
    print_table("", ("language", "sentence patterns", "held out for test_paraphrase_ood"), rows)
    fits = "the target only" if language.fit == "one" else "any of several objects"
    print_text(f"instructions fit {fits}; features: {', '.join(sorted(language.families))}")
    wanted = f", at least {language.in_view} in view at the start" if language.in_view else ""
    wanted += "; the target is drawn at the start" if language.exchangeable else ""
    if content is None:
        print_text(
            f"other objects of the target's category in the scene: not known before the scenes are built{wanted}"
        )
    else:
        shares = {others: count / content.episodes for others, count in content.distractors.items()}
        listed = ", ".join(f"{others} ({share:.0%})" for others, share in shares.items())
        print_text(f"other objects of the target's category in the scene, and share of the episodes: {listed}{wanted}")
    scenes = [] if forecast is None else list(forecast.starts)
    print_table("", ("feature", "asked %", "at most %", "expected %", *scenes), _feature_cells(language, forecast))
    if forecast is None:
        built = "its layouts are built" if any(scene.layouts for scene in plan.scenes) else "its scenes are built"
        print_text(f"the expected shares are known when {built}; a run builds them")
        return
    print_text(
        f"asked: share of the feature's weight; expected: share of {forecast.episodes} sentences of planned episodes, "
        "which may have several features; scenes: number of their starts that permit the feature, of "
        f"{', '.join(f'{count} ({name})' for name, count in forecast.starts.items())}"
    )
    if forecast.without:
        print_text(f"no sentence at the tried starts of {forecast.without} other episodes")


def _feature_cells(language: LanguageSpec, forecast: LanguageForecast | None) -> list[tuple[object, ...]]:
    rows = []
    for row in feature_data(language, forecast):
        percents = [None if row[key] is None else 100 * row[key] for key in ("asked", "largest", "expected")]
        rows.append((row["feature"], *percents, *row["offered"].values()))
    return rows


def feature_data(language: LanguageSpec, forecast: LanguageForecast | None) -> list[dict[str, Any]]:
    """Returns the asked and expected share of each feature as JSON data, in the order of the expected shares."""
    limits = {str(family): share for family, share in language.largest_shares.items()}
    rows = []
    for name, asked in language.feature_shares.items():
        row: dict[str, Any] = {"feature": name, "asked": asked, "largest": limits.get(name), "expected": None}
        row["offered"] = {}
        if forecast is not None:
            row["expected"] = forecast.features.get(name, 0) / max(1, forecast.episodes)
            row["offered"] = {scene: forecast.offered.get(name, {}).get(scene, 0) for scene in forecast.starts}
        rows.append(row)
    return sorted(rows, key=lambda row: -(row["expected"] or 0.0))


def print_offers(rows: Sequence[OfferRow]) -> None:
    """Prints which objects of each scene can be targets; the layouts of a family are one row."""
    merged: dict[tuple[str, Tier, str], list[OfferRow]] = {}
    for row in rows:
        merged.setdefault((family_of(row.scene), row.tier, row.category), []).append(row)
    has_groups = any(row.groups is not None for row in rows)
    cells = [
        (*key, *(sum(row.objects for row in group), sum(row.reachable for row in group)))
        + ((sum(row.groups or 0 for row in group),) if has_groups else ())
        for key, group in merged.items()
    ]
    columns = ("scene", "tier", "category", "targets", "reachable", *(("groups",) if has_groups else ()))
    print_table("objects that can be targets, of those with a start in the tier", columns, cells)
    if has_groups:
        print_text("groups: sets of objects of which each can be the target from one start")
