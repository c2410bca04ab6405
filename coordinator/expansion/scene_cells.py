"""Cells of a scene in a plan: quotas, permitted templates and targets, computed once per expansion. Pure functions."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property

from coordinator.expansion.catalog import Catalog, SceneEntry
from coordinator.expansion.cells import Cells, cells
from coordinator.expansion.far_tiers import with_far_tiers
from coordinator.expansion.instances import (
    Groups,
    NotAlone,
    Side,
    Sides,
    are_grouped,
    side_of,
    sides_of,
    startable_tiers,
)
from schemas.instruction.referents import referents
from schemas.instruction.templates import FROM_START, needs_colour, say_category, templates_for
from schemas.layouts import LayoutPlan
from schemas.plan import Plan, ScenePlan
from schemas.scene import SceneInfo, Target
from schemas.terms import Split, Tier


class Wording:
    """Words that the instructions of a plan may use in a scene.

    With `instructions.unique = "scene"`, category and named colour fit exactly one object of the scene, except for
    categories that the scene's plan lists as ambiguous. To support other words that identify a target, such as a
    relation to another object, extend this class.
    """

    def __init__(self, plan: Plan, scene: ScenePlan, info: SceneInfo) -> None:
        self._is_coloured = plan.colors == "on"
        self._least_others = None if plan.language is None else plan.language.least_others
        self._of_category = Counter(each.category for each in info.instances)
        self._ambiguous = None if plan.instructions.unique != "scene" else scene.ambiguous
        words = {(each.category, colour) for each in info.targets for colour in (None, self.colour_of(each))}
        self._unique = {
            (category, colour)
            for category, colour in words
            if self._needs_unique(category) and colour != "unknown" and len(referents(info, category, colour)) == 1
        }
        self.targets = tuple(each for each in info.targets if self.templates(Split.TRAIN_ID, each))
        """Targets for which a training template is permitted. A paraphrased template is then permitted too, because
        both kinds include templates with and without a colour."""

    def colour_of(self, target: Target) -> str:
        """Returns the colour word that instructions may use for a target, or `unknown`."""
        return target.colour if self._is_coloured else "unknown"

    def templates(self, split: Split, target: Target) -> tuple[str, ...]:
        """Returns the ids of the templates that a split may use for a target, in the paper's order."""
        if self._least_others is not None:
            return (FROM_START,) if self._of_category[target.category] > self._least_others else ()
        colour = self.colour_of(target)
        templates = templates_for(split, colour)
        if not self._needs_unique(target.category):
            return templates
        return tuple(
            each for each in templates if (target.category, colour if needs_colour(each) else None) in self._unique
        )

    def _needs_unique(self, category: str) -> bool:
        return self._ambiguous is not None and category not in self._ambiguous

    @property
    def unique(self) -> tuple[str, ...]:
        """Words that fit exactly one target of the scene, such as `red chair`; empty if the plan does not need them."""
        return tuple(sorted(f"{colour or ''} {say_category(name)}".strip() for name, colour in self._unique))


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
        return Wording(self.plan, self.scene, self.entry.info)

    @cached_property
    def sides(self) -> Sides:
        """Side of each instance (training, evaluation or both), if the plan separates instances."""
        base = self.plan.extended
        if base is None:
            return sides_of(self.plan, self.scene, self.wording.targets, self.quota, self.groups)
        scene = base.part(self.scene.name)
        return sides_of(base, scene, self.wording.targets, cells(base, scene), self.groups)

    @cached_property
    def groups(self) -> Groups | None:
        """Groups of objects that could be the target from one start; `None` if the plan names its targets."""
        if self.plan.language is None or not self.plan.language.exchangeable:
            return None
        from coordinator.expansion.offers import offered_groups  # imported here, because it loads the grammars

        return offered_groups(self.plan, self.entry)

    @cached_property
    def never_alone(self) -> NotAlone:
        """Objects that hardly any start shows alone; empty unless the plan requires this."""
        if self.plan.instructions.unique != "view":
            return frozenset()
        from coordinator.expansion.offers import never_alone  # imported here, because it loads the grammars

        return never_alone(self.plan, self.scene, self.entry) or frozenset()

    def templates(self, split: Split, tier: Tier, target: Target) -> tuple[str, ...]:
        """Returns the ids of the templates that a cell may use for a target.

        They exclude those that fit other objects in nearly every view of the target, unless all do.
        """
        permitted = self.wording.templates(split, target)
        return self._clear(permitted, tier, target) or permitted

    def _clear(self, templates: tuple[str, ...], tier: Tier, target: Target) -> tuple[str, ...]:
        number = target.instance_id
        return tuple(each for each in templates if (number, tier, needs_colour(each)) not in self.never_alone)

    @property
    def present(self) -> frozenset[str]:
        """Categories with a target that an instruction may name and that the robot can reach."""
        success = self.plan.task.success
        return frozenset(target.category for target in self.wording.targets if target.is_reachable(success))

    def pool(self, split: Split, tier: Tier) -> tuple[Target, ...]:
        """Returns the permitted targets of a cell.

        The split permits their category and side, they have a start pose for the expert in the tier, and an instruction
        may name them. If the target is drawn at the start, they belong to a group of such targets. If the instruction
        must fit one object in view, some starts show them alone; a category without such targets keeps all.
        """
        permitted = self.permitted(split, tier)
        if self.groups is None:
            clear = [each for each in permitted if self._clear(self.wording.templates(split, each), tier, each)]
            kept = {each.category for each in clear}
            return tuple(each for each in permitted if each in clear or each.category not in kept)
        whole = [group for group in self.groups[tier] if are_grouped(permitted, group)]
        return tuple(target for target in permitted if any(target.instance_id in group for group in whole))

    def permitted(self, split: Split, tier: Tier) -> tuple[Target, ...]:
        """Returns the targets that a cell permits without conditions on the view at the start."""
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
    return SceneCells(plan, scene, with_far_tiers(plan, entry), cells(plan, scene))


def each_scene(plan: Plan, catalog: Catalog) -> Iterator[SceneCells]:
    """Yields the cells of every scene, in the order of the plan; omits layouts that the catalog lacks."""
    for part in plan.parts:
        if part.name in catalog or not isinstance(part, LayoutPlan):
            yield scene_cells(plan, part, catalog[part.name])


def categories_of(scene: ScenePlan, split: Split) -> tuple[str, ...]:
    seen, held_out = scene.categories
    return held_out if split.is_held_out else seen
