"""Finds the cells of a plan that its scenes cannot fulfil."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Iterator, Sequence, Set

from coordinator.expansion.balance import layout_categories
from coordinator.expansion.catalog import Catalog, SceneEntry
from coordinator.expansion.scene_cells import SceneCells, categories_of, each_scene
from schemas.errors import InvalidPlan
from schemas.layouts import LayoutPlan
from schemas.plan import Plan, ScenePlan
from schemas.terms import Split, SuccessMeasure, Tier


def find_impossible(plan: Plan, catalog: Catalog) -> list[str]:
    """Returns a line for each fault: a scene that lacks categories, or a cell without a target."""
    return _find_impossible(plan, each_scene(plan, catalog))


def raise_if_impossible(plan: Plan, scenes: Sequence[SceneCells]) -> None:
    """Checks the cells of some scenes of a plan.

    Raises:
        InvalidPlan: a cell has no target that its tier can reach; the error lists every such cell.
    """
    mistakes = _find_impossible(plan, scenes)
    if mistakes:
        raise InvalidPlan(f"plan {plan.name!r} requires what its scenes do not have", mistakes)


def _find_impossible(plan: Plan, scenes: Iterable[SceneCells]) -> list[str]:
    return [line for cells in scenes for line in faults_of(cells, _place(plan, cells.scene))]


def _place(plan: Plan, scene: ScenePlan) -> str:
    family = scene.family if isinstance(scene, LayoutPlan) else scene
    return f"scenes[{plan.scenes.index(family)}] {scene.name}"


def faults_of(cells: SceneCells, place: str) -> Iterator[str]:
    """Yields a line for each reason why a scene cannot fulfil its quota.

    Args:
        cells: cells of the scene.
        place: text with which each line begins.
    """
    scene, entry = cells.scene, cells.entry
    success = cells.plan.task.success
    if success is SuccessMeasure.SURFACE and not entry.info.has_footprints:
        yield (
            f"{place}: its package is of an older version and has no footprints of targets, "
            'which task.success = "surface" needs; create it again with `factory scene build` or `factory scene '
            'import`, or set task.success = "centroid"'
        )
        return
    present = {target.category for target in entry.info.targets if target.is_reachable(success)}
    named = {split: set(categories_of(scene, split)) for split, _ in cells.quota}
    if any(categories - present for categories in named.values()):
        yield f"{place}: {_absent_message(scene, entry, present)}"
    ambiguous = {name for categories in named.values() for name in categories & present} - cells.present
    if ambiguous:
        yield f"{place}: {_ambiguous_message(cells, ambiguous)}"
    exact = layout_categories(cells.plan, scene) if cells.plan.balance == "categories_overall" else {}
    for (split, tier), count in cells.quota.items():
        lacking = exact.get((split, tier), {}).keys() - {target.category for target in cells.pool(split, tier)}
        if lacking and cells.pool(split, tier):
            names = ", ".join(sorted(lacking))
            yield f"{place}: cell {split} / {tier} has no start for the categories {names}, which its quota needs"
        if named[split] & cells.present and not cells.pool(split, tier):
            if cells.groups is not None:
                yield f"{place}: cell {split} / {tier} ({count} episodes): {_offer_message(cells, split, tier)}"
                continue
            yield (
                f"{place}: cell {split} / {tier} ({count} episodes) has no target with a start "
                f"pose for the {cells.plan.expert} expert; set tiers.{tier} or splits.{split} of the scene to 0, or "
                "change the scene"
            )


def _offer_message(cells: SceneCells, split: Split, tier: Tier) -> str:
    """Returns what a scene offers to a cell for which it has no start that shows several possible targets."""
    assert cells.groups is not None
    categories = {each.instance_id: each.category for each in cells.entry.info.targets}
    offered = {each: len(groups) for each, groups in cells.groups.items()}
    named = Counter(categories[next(iter(group))] for group in cells.groups[tier])
    groups = ", ".join(f"{count} of {name}" for name, count in sorted(named.items())) or "none"
    counts = ", ".join(f"{each} {count}" for each, count in offered.items())
    return (
        "no start shows several possible targets that an instruction distinguishes; groups of such objects in "
        "the scene: "
        f"{counts}; in the {tier} tier: {groups}; set tiers.{tier} or splits.{split} of the scene to 0, name other "
        "categories in seen, or set disjoint_instances = false"
    )


def _absent_message(scene: ScenePlan, entry: SceneEntry, present: Set[str]) -> str:
    absent = [[name for name in names if name not in present] for names in scene.categories]
    missing = [
        f"no reachable {', '.join(map(repr, names))} ({key})"
        for key, names in zip(("seen", "held_out"), absent, strict=True)
        if names
    ]
    lacking = {name for names in absent for name in names}
    shown = {one.category for one in entry.info.instances} & lacking
    blocked = f"; present but not reachable: {', '.join(sorted(filter(None, shown)))}" if shown else ""
    remedy = "remove the missing categories from seen and held_out, or change the scene"
    by_surface = {one.category for one in entry.info.targets if one.is_reachable(SuccessMeasure.SURFACE)} & lacking
    if by_surface:
        remedy = f'set task.success = "surface" to reach {", ".join(sorted(by_surface))}, or {remedy}'
    if scene.file is not None:
        remedy += ", its rules or its list of targets"
    return f"{', '.join(missing)}; reachable in the scene: {', '.join(sorted(present)) or 'none'}{blocked}; {remedy}"


def _ambiguous_message(cells: SceneCells, ambiguous: Set[str]) -> str:
    if cells.plan.language is not None:
        return (
            f"[language] requires {cells.plan.language.least_others} other objects of the target's category; "
            f"categories with fewer: {', '.join(sorted(ambiguous))}; categories with enough objects: "
            f"{', '.join(sorted(cells.present)) or 'none'}; remove the others from seen and held_out, or reduce "
            "language.same_category and language.in_view"
        )
    unique = ", ".join(cells.wording.unique)
    return (
        f'instructions.unique is "scene", but no instruction fits only one {" or ".join(sorted(ambiguous))}; '
        f"unique in the scene: {unique or 'nothing'}; remove the other categories from seen and held_out, or set "
        'instructions.unique to "view", or list them in `ambiguous` of the scene'
    )
