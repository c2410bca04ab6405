"""Computes the feasible plan nearest to an infeasible one: it moves the fewest episodes to other cells.

The functions have no side effects.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Set
from dataclasses import dataclass
from itertools import combinations, product
from typing import TypeVar

from coordinator.expansion.catalog import Catalog, SceneEntry
from coordinator.expansion.cells import Cells, cells
from coordinator.expansion.scene_cells import scene_cells
from schemas.plan import Plan, ScenePlan
from schemas.terms import Split, Tier

Share = TypeVar("Share", Split, Tier)


@dataclass(frozen=True)
class NearestPlan:
    """Nearest feasible plan."""

    plan: Plan | None
    """The feasible plan; `None` if no scene has a target that the plan names and that has a start pose for the
    expert."""
    changes: tuple[str, ...]
    """Differences, one line per scene; empty if the plan is feasible."""
    moved: int
    """Number of episodes of the infeasible plan that are moved to other cells or are omitted."""


def find_nearest(plan: Plan, catalog: Catalog) -> NearestPlan:
    """Returns a plan in which every cell has a target.

    Categories that a scene lacks are removed from it. If a scene then has cells without a target, the function keeps
    the feasible combination of tiers and splits with the most episodes and rescales its shares. A scene without any
    feasible cell is removed.
    """
    kept: list[ScenePlan] = []
    changes: list[str] = []
    moved = 0
    for scene in plan.scenes:
        if scene.layouts is not None:  # a layout that does not fulfil the plan is refused when it is built
            kept.append(scene)
            continue
        # compares whole combinations: the removal of one tier or split after another can end with a single split
        part = _possible(plan, scene, catalog[scene.name])
        lost = _moved(cells(plan, scene), {} if part is None else cells(plan, part))
        moved += lost
        if part is not None:
            kept.append(part)
        if part != scene:
            changes.append(_change_message(plan, scene, part=part, entry=catalog[scene.name], lost=lost))
    return NearestPlan(plan.model_copy(update={"scenes": tuple(kept)}) if kept else None, tuple(changes), moved)


def _possible(plan: Plan, scene: ScenePlan, entry: SceneEntry) -> ScenePlan | None:
    """Returns the scene reduced to feasible categories, tiers and splits; `None` if no cell is feasible."""
    part = _with_categories(plan, scene, scene_cells(plan, scene, entry).present)
    if part is None:
        return None
    scene_of_cells = scene_cells(plan, part, entry)
    if all(scene_of_cells.pool(*cell) for cell in scene_of_cells.quota):
        return part
    # which cells would have targets if training and evaluation shared instances
    free = plan.model_copy(update={"disjoint_instances": False})
    tiers, splits = _positive(plan.tiers_of(part)), _positive(plan.splits_of(part))
    shared = scene_cells(free, part, entry)
    able = {cell for cell in product(splits, tiers) if shared.pool(*cell)}
    best = max(
        (
            (
                sum(splits[split] for split in some_splits) * sum(tiers[tier] for tier in some_tiers),
                some_splits,
                some_tiers,
            )
            for some_splits, some_tiers in product(_subsets(list(splits)), _subsets(list(tiers)))
            if able.issuperset(product(some_splits, some_tiers))
        ),
        key=lambda option: option[0],
        default=None,
    )
    if best is None:
        return None
    _, some_splits, some_tiers = best
    changes: dict[str, object] = {}
    if len(some_splits) < len(splits):
        changes["splits"] = _only(splits, some_splits)
    if len(some_tiers) < len(tiers):
        changes["tiers"] = _only(tiers, some_tiers)
    return part.model_copy(update=changes)


def _subsets(keys: list[Share]) -> list[tuple[Share, ...]]:
    """Returns all non-empty subsets, larger ones first."""
    return [some for size in range(len(keys), 0, -1) for some in combinations(keys, size)]


def _with_categories(plan: Plan, scene: ScenePlan, present: Set[str]) -> ScenePlan | None:
    """Returns the scene without absent categories, and without splits that have absent categories only."""
    seen, held_out = (tuple(name for name in names if name in present) for names in scene.categories)
    part: ScenePlan | None = scene
    if (seen, held_out) != tuple(scene.categories):
        ambiguous = tuple(name for name in scene.ambiguous if name in present)
        part = scene.model_copy(update={"seen": seen, "held_out": held_out, "ambiguous": ambiguous})
    names_seen = [split for split in Split if not split.is_held_out]
    for split in [
        *([] if seen else names_seen),
        *([] if held_out else [split for split in Split if split.is_held_out]),
    ]:
        if part is not None and plan.splits_of(part).get(split, 0) > 0:
            shares = _positive(plan.splits_of(part))
            shares = _only(shares, [key for key in shares if key is not split])
            part = part.model_copy(update={"splits": shares}) if shares else None
    return part


def _positive(shares: Mapping[Share, float]) -> dict[Share, float]:
    return {key: share for key, share in shares.items() if share > 0}


def _only(shares: Mapping[Share, float], kept: Iterable[Share]) -> dict[Share, float]:
    """Returns the kept shares, rescaled to sum to 1; empty if `kept` is empty."""
    total = sum(shares[key] for key in kept)
    return {key: shares[key] / total for key in kept}


def _moved(wanted: Cells, quotas: Cells) -> int:
    return sum(max(0, count - quotas.get(cell, 0)) for cell, count in wanted.items())


def _change_message(plan: Plan, scene: ScenePlan, part: ScenePlan | None, entry: SceneEntry, lost: int) -> str:
    present = scene_cells(plan, scene, entry).present
    if part is None:
        listed = {target.category for target in entry.info.targets}
        is_there = any(name in listed for names in scene.categories for name in names)
        why = "no target of these categories is reachable" if is_there else "it has none of the requested categories"
        return f"{scene.name}: removed, {lost} episodes; {why}"
    words = []
    for key, categories in zip(("seen", "held_out"), scene.categories, strict=True):
        gone = [name for name in categories if name not in present]
        if gone:
            words.append(f"{key} without {', '.join(gone)}")
    tiers, splits = plan.tiers_of(part), plan.splits_of(part)
    if tiers != plan.tiers_of(scene):
        words.append("tiers " + _format_shares({str(tier): tiers.get(tier, 0.0) for tier in plan.tiers_of(scene)}))
    if splits != plan.splits_of(scene):
        words.append(
            "splits " + _format_shares({str(split): splits.get(split, 0.0) for split in plan.splits_of(scene)})
        )
    return f"{scene.name}: {'; '.join(words)} ({lost} of {scene.episodes} episodes in other cells)"


def _format_shares(shares: Mapping[str, float]) -> str:
    return ", ".join(f"{key} {share:.4g}" for key, share in shares.items())
