"""Assigns the instances of a scene to training or evaluation for plans with `disjoint_instances`.

The module does not assign instances of held-out categories: only the split `test_ood_obj` names them.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence, Set
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
Groups = Mapping[Tier, tuple[frozenset[int], ...]]
"""Sets of ids of objects that could be the target from one start, by tier."""
NotAlone = Set[tuple[int, Tier, bool]]
"""Ids of objects with a tier in which hardly any start shows them without the others that their instruction fits, and
whether this instruction names the colour."""


def side_of(split: Split) -> Side:
    """Returns the side of a split of seen categories."""
    return Side.TRAIN if split is Split.TRAIN_ID else Side.EVALUATION


def startable_tiers(plan: Plan, scene: ScenePlan, target: Target) -> tuple[Tier, ...]:
    """Returns the tiers in which a target of a scene has a start pose that the plan's expert can use."""
    is_any_start = plan.expert is ExpertName.PLANNER or not plan.spawn_of(scene.name).needs_free_line
    return target.tiers(plan.task.success, is_any_start)


def are_grouped(targets: Sequence[Target], group: frozenset[int]) -> bool:
    """Returns whether a group consists of some targets only."""
    return group <= {target.instance_id for target in targets}


def sides_of(
    plan: Plan, scene: ScenePlan, targets: Sequence[Target], quota: Cells, groups: Groups | None = None
) -> Sides:
    """Returns the side of every startable instance of a seen category; empty if the plan does not separate instances.

    The instances of each category are divided in proportion to the episodes of training and evaluation, with at least
    one instance per side. A category with a single instance is shared. If a cell would otherwise have no target, the
    categories with starts in its tier are shared, too. If a plan draws targets from groups of objects, both sides get
    whole groups.
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
        group = [group[int(place)] for place in rng.permutation(len(group))]
        sides |= _divide(plan, scene, group, wanted) if groups is None else divide_groups(group, groups, wanted)
    return _with_all_cells_filled(plan, scene, quota=quota, options=options, sides=sides, groups=groups)


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


def divide_groups(targets: list[Target], groups: Groups, wanted: Mapping[Side, int]) -> dict[str, Side]:
    """Divides the instances of one category so that both sides get whole groups in as many tiers as possible."""
    share = wanted[Side.TRAIN] / sum(wanted.values())
    grouped = frozenset().union(*(group for each in groups.values() for group in each))
    line = _neighbours([each for each in targets if each.instance_id in grouped], groups)
    cuts = range(len(line) + 1)
    cut = max(cuts, key=lambda at: (_filled(line[:at], line[at:], groups), -abs(at - share * len(line))))
    others = [each for each in targets if each.instance_id not in grouped]
    rest = round(share * len(others))
    training = {each.target_id for each in (*line[:cut], *others[:rest])}
    return {each.target_id: Side.TRAIN if each.target_id in training else Side.EVALUATION for each in targets}


def _filled(train: list[Target], evaluation: list[Target], groups: Groups) -> tuple[int, int]:
    """Returns the number of tiers in which both sides have a group, and of tiers in which the training side has one."""
    has = [
        [any(are_grouped(side, group) for group in each) for side in (train, evaluation)] for each in groups.values()
    ]
    return sum(all(sides) for sides in has), sum(sides[0] for sides in has)


def _neighbours(targets: list[Target], groups: Groups) -> list[Target]:
    """Returns the targets in an order in which those that share groups are close together."""
    line: list[Target] = []
    sets = [group for each in groups.values() for group in each]
    while targets:
        placed = {each.instance_id for each in line}
        shared = [sum(len(group & placed) for group in sets if each.instance_id in group) for each in targets]
        line.append(targets[shared.index(max(shared))])
        targets = [each for each in targets if each is not line[-1]]
    return line


def _with_all_cells_filled(
    plan: Plan,
    scene: ScenePlan,
    quota: Mapping[tuple[Split, Tier], int],
    options: list[Target],
    sides: dict[str, Side],
    groups: Groups | None,
) -> Sides:
    for split, tier in quota:
        if split.is_held_out:
            continue
        able = [target for target in options if tier in startable_tiers(plan, scene, target)]
        own = [target for target in able if sides[target.target_id] in (side_of(split), Side.SHARED)]
        if groups is not None:
            able = [each for each in able if any(each.instance_id in group for group in groups[tier])]
            own = own if any(are_grouped(own, group) for group in groups[tier]) else []
        if not own:
            opened = {target.category for target in able}
            sides |= {target.target_id: Side.SHARED for target in options if target.category in opened}
    return sides
