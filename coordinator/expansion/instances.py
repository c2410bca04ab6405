"""Assigns the instances of a scene to training or evaluation for plans with `disjoint_instances`.

The module does not assign instances of held-out categories: only the split `test_ood_obj` names them.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from enum import StrEnum

import numpy as np

from coordinator.expansion.catalog import SceneEntry
from coordinator.expansion.cells import Cells
from schemas.plan import Plan, ScenePlan
from schemas.scene import Target
from schemas.support.apportion import webster_sequence
from schemas.terms import ExpertName, Split, Tier

_SIDES_STREAM = 3


class Side(StrEnum):
    """Splits that may name an instance of a seen category."""

    TRAIN = "train"  # train_id only
    EVALUATION = "evaluation"  # val_id, test_id and test_paraphrase_ood only
    SHARED = "shared"  # both: the scene has too few instances of the category


Sides = Mapping[str, Side]
"""Mapping of target id to side, for the instances of seen categories."""


def side_of(split: Split) -> Side:
    """Returns the side of a split of seen categories."""
    return Side.TRAIN if split is Split.TRAIN_ID else Side.EVALUATION


def startable_tiers(plan: Plan, scene: ScenePlan, target: Target) -> tuple[Tier, ...]:
    """Returns the tiers in which a target of a scene has a start pose that the plan's expert can use."""
    is_any_start = plan.expert is ExpertName.PLANNER or not plan.spawn_of(scene.name).needs_free_line
    return target.tiers(plan.task.success, is_any_start)


def sides_of(plan: Plan, scene: ScenePlan, targets: Sequence[Target], quota: Cells) -> Sides:
    """Returns the side of every startable instance of a seen category; empty if the plan does not separate instances.

    The instances of each category are divided in proportion to the episodes of training and evaluation, with at least
    one instance per side. A category with a single instance is shared. If a cell would otherwise have no target, the
    categories with starts in its tier are shared, too.
    """
    wanted = dict.fromkeys((Side.TRAIN, Side.EVALUATION), 0)
    for (split, _), count in quota.items():
        if not split.is_held_out:
            wanted[side_of(split)] += count
    if not plan.disjoint_instances or not all(wanted.values()):
        return {}
    tiers = {tier for _, tier in quota}
    options = [t for t in targets if t.category in scene.categories.seen]
    options = [t for t in options if tiers & set(startable_tiers(plan, scene, t))]
    number = [part.name for part in plan.parts].index(scene.name)
    rng = np.random.default_rng(np.random.SeedSequence((plan.seed, _SIDES_STREAM, number)))
    sides: dict[str, Side] = {}
    for category in sorted({target.category for target in options}):
        group = [target for target in options if target.category == category]
        sides |= _divide(plan, scene, [group[int(place)] for place in rng.permutation(len(group))], wanted)
    return _with_all_cells_filled(plan, scene, quota=quota, options=options, sides=sides)


def shared_categories(sides: Sides, entry: SceneEntry) -> tuple[str, ...]:
    """Returns the categories whose instances training and evaluation share."""
    return tuple(sorted({t.category for t in entry.info.targets if sides.get(t.target_id) is Side.SHARED}))


def _divide(plan: Plan, scene: ScenePlan, group: list[Target], wanted: Mapping[Side, int]) -> dict[str, Side]:
    if len(group) == 1:
        return {group[0].target_id: Side.SHARED}
    # targets with starts in the most tiers come first, so both sides get some of these targets
    group = sorted(group, key=lambda target: -len(startable_tiers(plan, scene, target)))
    # not by a hash of the id, which could put all instances of a small category on one side
    order = webster_sequence({side: float(count) for side, count in wanted.items()}, len(group))
    for side in wanted:
        if side not in order:
            order[-1] = side
    for place, side in enumerate(wanted):
        position = order.index(side)
        order[place], order[position] = order[position], order[place]
    return {target.target_id: side for target, side in zip(group, order, strict=True)}


def _with_all_cells_filled(
    plan: Plan,
    scene: ScenePlan,
    quota: Mapping[tuple[Split, Tier], int],
    options: list[Target],
    sides: dict[str, Side],
) -> Sides:
    for split, tier in quota:
        if split.is_held_out:
            continue
        able = [target for target in options if tier in startable_tiers(plan, scene, target)]
        if not any(sides[target.target_id] in (side_of(split), Side.SHARED) for target in able):
            opened = {target.category for target in able}
            sides |= {target.target_id: Side.SHARED for target in options if target.category in opened}
    return sides
