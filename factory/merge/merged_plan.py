"""Describes several plans by one, for a dataset with the episodes of all of them. Pure functions; reads no dataset.

The plan of the whole dataset states what readers need: robot, camera, task and sensors, which all plans must share, and
the scenes with their episodes and shares. Each source keeps its own plan, which generates its episodes.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from typing import Literal

from pydantic import ValidationError

from coordinator.expansion.cells import Cell, cells, marginal
from coordinator.ledger.opening import plan_differences
from schemas.config import InstructionConfig
from schemas.errors import UsageError
from schemas.layouts import LayoutPlan, unseen_layouts
from schemas.plan import Plan, ScenePlan
from schemas.terms import Recording, Split, Tier

NAME = "merged"
"""Name of the plan of a merged dataset."""
_SHARED = ("record", "task", "robot", "camera", "rig", "appearance")
"""Keys with which readers interpret every episode of a dataset."""
Named = Sequence[tuple[str, Plan]]
"""Plans with the names of their datasets."""


def merged_plan(named: Named) -> Plan:
    """Returns the plan of the dataset with the episodes of several plans.

    Args:
        named: plans in the order of their episodes.

    Raises:
        UsageError: the plans cannot share a dataset.
    """
    _require_equal_readers(named)
    plans = [plan for _, plan in named]
    first = next((plan for plan in plans if plan.language is not None), plans[0])
    language = first.language
    if language is not None and any(plan.language != language for plan in plans):
        language = language.model_copy(update={"exchangeable": False})  # its plan has no targets of other sources
    scenes = _scenes(named)
    values = {
        **dict(first),
        "name": NAME,
        "seed": plans[0].seed,
        "scenes": scenes,
        "tiers": _shares(_counts(plans, 1)),
        "splits": _shares(_counts(plans, 0)),
        "language": language,
        "instructions": first.instructions if language is None else InstructionConfig(),
        "disjoint_instances": all(plan.disjoint_instances for plan in plans),
        "extends": None,
    }
    try:
        return Plan.model_validate_json(Plan.model_construct(**values).model_dump_json())
    except ValidationError as error:
        lines = "".join(f"\n  - {each['msg']}" for each in error.errors())
        raise UsageError(f"no plan describes {_names(named)} together, so they cannot be merged:{lines}") from error


def _require_equal_readers(named: Named) -> None:
    name, plan = named[0]
    for other, theirs in named[1:]:
        if {plan.record, theirs.record} == set(Recording):
            states = name if plan.record is Recording.STATES else other
            raise UsageError(
                f"{name} stores {plan.record} and {other} stores {theirs.record}, and a dataset has one kind of "
                "episode: "
                f"render the frames of {states} with `factory render STATES -o FRAMES` and merge FRAMES instead"
            )
        unlike = [key for key in _SHARED if getattr(plan, key) != getattr(theirs, key)]
        if unlike:
            kept = {key: getattr(plan, key) for key in unlike}
            lines = plan_differences(theirs.model_copy(update=kept), theirs)
            raise UsageError(
                f"{name} and {other} differ in {', '.join(unlike)}, with which readers interpret every episode of a "
                f"dataset, so they cannot be merged; recorded is {name}, requested is {other}:"
                + "".join(f"\n  - {line}" for line in lines)
            )


def _scenes(named: Named) -> tuple[ScenePlan, ...]:
    """Returns one entry for each scene of the plans; a family stays one entry if all plans have the same layouts."""
    entries: dict[str, list[tuple[str, Plan, ScenePlan]]] = {}
    for name, plan in named:
        for scene in plan.scenes:
            entries.setdefault(scene.name, []).append((name, plan, scene))
    merged = []
    for group in entries.values():
        if len({_layouts_of(plan, scene) for _, plan, scene in group}) == 1:
            merged.append(_joined(group))
            continue
        parts: dict[str, list[tuple[str, Plan, ScenePlan]]] = {}
        for name, plan, scene in group:
            for part in plan.parts:
                if part.name == scene.name or (isinstance(part, LayoutPlan) and part.family.name == scene.name):
                    parts.setdefault(part.name, []).append((name, plan, part))
        merged += [_joined(each) for each in parts.values()]
    names = Counter(scene.name for scene in merged)
    doubled = [name for name, count in names.items() if count > 1]
    if doubled:
        raise UsageError(f"{_names(named)} use {', '.join(doubled)} both as one scene and as a layout; merge others")
    return tuple(merged)


def _layouts_of(plan: Plan, scene: ScenePlan) -> tuple[int | None, int, int]:
    return scene.layouts, scene.seed, unseen_layouts(scene, plan.splits_of(scene)) if scene.layouts else 0


def _joined(group: Sequence[tuple[str, Plan, ScenePlan]]) -> ScenePlan:
    """Returns the entry of one scene with the episodes of all plans."""
    _, first_plan, first = group[0]
    _require_equal_categories(group)
    total: Counter[Cell] = Counter()
    for _, plan, scene in group:
        total.update(cells(plan, scene))
    scene = first.as_scene() if isinstance(first, LayoutPlan) else first
    held = {name for _, _, each in group for name in each.ambiguous}
    changes: dict[str, object] = {
        "episodes": sum(each.episodes for _, _, each in group),
        "splits": _shares(marginal(total, 0)),
        "tiers": _shares(marginal(total, 1)),
        "ambiguous": tuple(sorted(held)),
    }
    if any(each.categories != first.categories for _, _, each in group):
        both = [each.categories for _, _, each in group]
        changes["seen"] = tuple(dict.fromkeys(name for each in both for name in each.seen))
        changes["held_out"] = tuple(dict.fromkeys(name for each in both for name in each.held_out))
    if scene.layouts:
        changes["unseen_layouts"] = unseen_layouts(first, first_plan.splits_of(first)) or None
    return scene.model_copy(update=changes)


def _require_equal_categories(group: Sequence[tuple[str, Plan, ScenePlan]]) -> None:
    """Raises `UsageError` if one plan trains on what another holds out: categories, or the layout itself."""
    seen = {category: name for name, _, scene in group for category in scene.categories.seen}
    for name, _, scene in group:
        for category in scene.categories.held_out:
            if category in seen:
                raise UsageError(
                    f"{seen[category]} trains on {category} in {scene.name}, but {name} holds the category out for "
                    "test_ood_obj, so the splits of a merged dataset would not be separate: merge datasets with the "
                    "same "
                    "held-out categories"
                )
    kinds = {each.is_unseen: name for name, _, each in group if isinstance(each, LayoutPlan)}
    if len(kinds) > 1:
        raise UsageError(
            f"{kinds[False]} trains in the layout {group[0][2].name}, but {kinds[True]} keeps it for "
            "test_unseen_scene*, so the splits of a merged dataset would not be separate: give the plans different "
            "`seed`s of the family"
        )


def _counts(plans: Sequence[Plan], axis: Literal[0, 1]) -> Counter[Split | Tier]:
    total: Counter[Split | Tier] = Counter()
    for plan in plans:
        for part in plan.parts:
            total += marginal(cells(plan, part), axis)
    return total


def _shares(counts: Mapping[Split | Tier, int]) -> dict[Split | Tier, float]:
    return {key: count / sum(counts.values()) for key, count in counts.items() if count}


def _names(named: Named) -> str:
    return " and ".join(name for name, _ in named)
