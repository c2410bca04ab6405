"""Cells of a scene in a plan: quotas and permitted targets, computed once per expansion. Pure functions."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property

from coordinator.expansion.catalog import Catalog, SceneEntry
from coordinator.expansion.cells import Cells, cells
from coordinator.expansion.far_tiers import with_far_tiers
from coordinator.expansion.instances import Side, Sides, side_of, sides_of, startable_tiers
from coordinator.expansion.wording import Wording
from schemas.layouts import LayoutPlan
from schemas.plan import Plan, ScenePlan
from schemas.scene import Target
from schemas.terms import Split, Tier


@dataclass(frozen=True)
class SceneCells:
    """Scene of a plan with the data from which its episodes are drawn."""

    plan: Plan
    scene: ScenePlan
    entry: SceneEntry
    """Compiled scene."""
    quota: Cells
    """Number of episodes of each cell."""

    @cached_property
    def wording(self) -> Wording:
        """Words that instructions may use in the scene."""
        return Wording(self.plan, self.scene, self.entry.info)

    @cached_property
    def sides(self) -> Sides:
        """Side of each instance (training, evaluation or both), if the plan separates instances."""
        return sides_of(self.plan, self.scene, self.wording.targets, self.quota)

    @property
    def present(self) -> frozenset[str]:
        """Categories with a target that an instruction may name and that the robot can reach."""
        success = self.plan.task.success
        return frozenset(target.category for target in self.wording.targets if target.is_reachable(success))

    def pool(self, split: Split, tier: Tier) -> tuple[Target, ...]:
        """Returns the permitted targets of a cell.

        The split permits their category and side, they have a start pose for the expert in the tier, and an instruction
        may name them.
        """
        categories = categories_of(self.scene, split)
        sides = {} if split.is_held_out else self.sides
        return tuple(
            target
            for target in self.wording.targets
            if target.category in categories
            and tier in startable_tiers(self.plan, self.scene, target)
            and sides.get(target.target_id, Side.SHARED) in (side_of(split), Side.SHARED)
        )


def scene_cells(plan: Plan, scene: ScenePlan, entry: SceneEntry) -> SceneCells:
    """Returns the cells of one scene of a plan."""
    return SceneCells(plan, scene, with_far_tiers(plan, entry), cells(plan, scene))


def each_scene(plan: Plan, catalog: Catalog) -> Iterator[SceneCells]:
    """Yields the cells of every scene, in the order of the plan; omits layouts that the catalog lacks."""
    for part in plan.parts:
        if part.name in catalog or not isinstance(part, LayoutPlan):
            yield scene_cells(plan, part, catalog[part.name])


def categories_of(scene: ScenePlan, split: Split) -> tuple[str, ...]:
    """Returns the categories that a split of a scene names."""
    seen, held_out = scene.categories
    return held_out if split.is_held_out else seen
