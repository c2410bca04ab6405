"""`factory plan`: shows the episodes of a plan, and finds the nearest plan that its scenes support."""

from __future__ import annotations

import shlex
import tempfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from coordinator.expansion.balance import planned_categories
from coordinator.expansion.cells import cells
from coordinator.expansion.nearest import find_nearest
from coordinator.expansion.plan_file import load_plan, plan_to_toml
from coordinator.expansion.possible import find_impossible
from coordinator.expansion.sentences import find_missing_instructions
from coordinator.expansion.summary import PlanSummary, summarise
from factory.commands.common.output import print_building, print_json, print_table, print_text, stderr
from factory.commands.common.plan_changes import shrunk_plan, warn_of_empty_splits
from factory.runs.catalog import collect_scenes, find_built, require_files
from factory.runs.corners import corner_shares
from factory.support.settings import scene_cache
from schemas.errors import InvalidPlan, WorldError
from schemas.instruction.templates import TEMPLATES
from schemas.language.compose import Composer
from schemas.language.language_file import LanguageSpec
from schemas.layouts import unseen_layouts
from schemas.plan import Plan, ScenePlan
from schemas.terms import Tier, family_of


def show(plan_name: str, as_json: bool, **changes: Any) -> None:
    """Executes `factory plan show`."""
    plan = shrunk_plan(load_plan(plan_name), changes)
    require_files(plan)
    found = find_built(plan, scene_cache())
    unknown = [scene.name for scene in plan.scenes if scene.layouts is None and scene.name not in found]
    families = [scene for scene in plan.scenes if scene.layouts is not None]
    mistakes = None if unknown else find_impossible(_without_families(plan), found)
    content = summarise(plan, found) if mistakes == [] and not families else None
    in_layouts = dict(planned_categories(plan).most_common())
    mistakes = find_missing_instructions(_without_families(plan), found) if mistakes == [] else mistakes
    corners = {} if content is None else corner_shares(plan, found)
    if as_json:
        told: dict[str, Any] = {"plan": plan.model_dump(mode="json"), "digest": plan.digest, "cells": list(_rows(plan))}
        told |= {"content": None if content is None else _content_data(content) | {"far_corner_shares": corners}}
        print_json(told | {"categories_in_layouts": in_layouts, "mistakes": mistakes, "not_built": unknown})
        return
    facts = f"{plan.episodes} episodes of {plan.record}, seed {plan.seed}, expert {plan.expert}, run {plan.run}"
    print_text(f"plan {plan.name}: {facts}" + ("" if plan.rig is None else f", {plan.view.describe()}"))
    for scene in plan.scenes:
        seen, held_out = scene.categories
        print_text(f"  {scene.name}: seen {', '.join(seen)}; held-out {', '.join(held_out) or 'none'}")
        if scene.layouts is not None:
            print_text(f"    {_describe_layouts(plan, scene)}")
    _print_cells(plan)
    if content is not None:
        _print_content(plan, content)
    if families:
        _print_layout_categories(in_layouts)
    if corners:
        listed = ", ".join(f"{name} {share:.0%}" for name, share in corners.items())
        print_text(f"far starts without a free straight line to the target, expected: {listed}")
    warn_of_empty_splits(plan)
    for line in mistakes or ():
        print_text(f"impossible: {line}")
    nearest = f"`factory plan nearest {shlex.quote(plan_name)}`"
    if mistakes and content is None:
        print_text(f"find the nearest feasible plan with {nearest}")
    elif unknown:
        print_text(
            f"note: the plan was not checked against its scenes, because these are not built: {', '.join(unknown)}; "
            f"{nearest} builds them and checks the plan",
            stderr,
        )


def nearest(plan_name: str, out: Path | None, as_json: bool, **changes: Any) -> None:
    """Executes `factory plan nearest`."""
    plan = shrunk_plan(load_plan(plan_name), changes)
    fixed = _without_families(plan)
    with tempfile.TemporaryDirectory(prefix="plan-") as folder:
        catalog = collect_scenes(fixed, Path(folder), scene_cache(), print_building)
    mistakes, found = find_impossible(fixed, catalog), find_nearest(plan, catalog)
    if found.plan is None:
        raise InvalidPlan(f"the scenes of plan {plan.name!r} support neither it nor any similar plan", mistakes)
    if out is not None:
        _write(out, plan_to_toml(found.plan))
    if as_json:
        told = {"possible": not mistakes, "mistakes": mistakes, "changes": found.changes, "moved": found.moved}
        told |= {"plan": found.plan.model_dump(mode="json"), "cells": list(_rows(found.plan))}
        print_json(told | {"file": None if out is None else str(out)})
        return
    if not mistakes:
        print_text(f"plan {plan.name} is feasible without changes: {plan.episodes} episodes")
    else:
        for line in mistakes:
            print_text(f"impossible: {line}")
        print_text(
            f"nearest plan: {found.plan.episodes} of {plan.episodes} episodes, {found.moved} of them moved to another "
            "split or tier"
        )
        for line in found.changes:
            print_text(f"  {line}")
        _print_cells(found.plan)
    if out is not None:
        print_text(f"plan written to {out}; generate the dataset with: factory run {out} --out DIR")


def _without_families(plan: Plan) -> Plan:
    return plan.model_copy(update={"scenes": tuple(scene for scene in plan.scenes if scene.layouts is None)})


def _describe_layouts(plan: Plan, scene: ScenePlan) -> str:
    """Returns the layouts of a family in one line, such as `6 layouts home_00000 to home_00005, 4 episodes each`."""
    parts = [part for part in plan.parts if family_of(part.name) == scene.name]
    counts = sorted({part.episodes for part in parts})
    each = f"{counts[0]} to {counts[-1]}" if len(counts) > 1 else f"{counts[0]}"
    unseen = unseen_layouts(scene, plan.splits_of(scene))
    kept = f"; the last {unseen} only for test_unseen_scene*" if unseen else ""
    return f"{len(parts)} layouts {parts[0].name} to {parts[-1].name}, {each} episodes each{kept}"


def _write(path: Path, text: str) -> None:
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text, encoding="utf-8")
    except OSError as error:
        raise WorldError(f"cannot write {path} ({error.strerror}); choose another file with -o") from error


def _content_data(content: PlanSummary) -> dict[str, Any]:
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


def _print_content(plan: Plan, content: PlanSummary) -> None:
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


def _print_layout_categories(episodes: Mapping[str, int]) -> None:
    if not episodes:
        print_text(
            'categories of the layouts: not known yet, because balance = "instances" draws evenly over the objects; '
            'balance = "categories" gives each category the same number of episodes'
        )
        return
    total = sum(episodes.values())
    rows = [(name, count, 100 * count / total) for name, count in episodes.items()]
    print_table("categories of the layouts", ("category", "episodes", "share %"), rows)


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


def _print_cells(plan: Plan) -> None:
    rows = [(row["scene"], row["split"], *(row[tier] for tier in Tier), row["episodes"]) for row in _rows(plan)]
    print_table("", ("scene", "split", *(str(tier) for tier in Tier), "episodes"), rows)


def _rows(plan: Plan) -> list[dict[str, Any]]:
    rows = []
    for scene in plan.scenes:
        quota = cells(plan, scene)
        for split in plan.splits_of(scene):
            counts: dict[str, Any] = {str(tier): quota.get((split, tier), 0) for tier in Tier}
            if sum(counts.values()):
                rows.append({"scene": scene.name, "split": str(split), **counts, "episodes": sum(counts.values())})
    return rows
