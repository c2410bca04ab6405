"""Summarises the planned episodes: shares of categories and templates, and expected ambiguity of the instructions.

Expands the plan. Does not simulate, so the draws that replace failed draws are not in the summary.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass

from coordinator.expansion.catalog import Catalog
from coordinator.expansion.draw import expand
from coordinator.expansion.plan_file import shrink
from coordinator.expansion.scene_cells import each_scene
from schemas.instruction.referents import referents, referents_of
from schemas.plan import Plan
from schemas.terms import Tier

MOST_SUMMARISED = 6_000
"""Largest number of expanded episodes; a larger plan is reduced to it in the same proportions."""


@dataclass(frozen=True)
class PlanSummary:
    """Content of the planned episodes."""

    episodes: int
    """Number of expanded episodes."""
    categories: Mapping[str, int]
    """Number of episodes by category of the target, in descending order."""
    templates: Mapping[str, int]
    """Number of episodes by template, in the order of the ids."""
    ambiguous: int
    """Number of instructions that fit several objects of their scene."""
    shown_alone: int
    """Number of ambiguous instructions whose start is drawn again until they fit only one object in view."""

    distractors: Mapping[int, int]
    """Number of episodes by the number of other objects of the target's category in the scene."""

    @property
    def top_three_share(self) -> float:
        """Share of the three most frequent categories."""
        return sum(list(self.categories.values())[:3]) / self.episodes


def summarise(plan: Plan, catalog: Catalog) -> PlanSummary:
    """Returns the summary of a plan, of at most `MOST_SUMMARISED` episodes; omits layouts that the catalog lacks.

    Raises:
        InvalidPlan: a cell has no target that its tier can reach.
    """
    part = shrink(plan, episodes=min(plan.episodes, MOST_SUMMARISED))
    specs = Counter(job.episode for job in expand(part, catalog))
    exempt = {(scene.name, name) for scene in plan.scenes for name in scene.ambiguous}
    distractors: Counter[int] = Counter()
    categories: Counter[str] = Counter()
    templates: Counter[str] = Counter()
    ambiguous = shown_alone = 0
    for spec, count in specs.items():
        categories[spec.category] += count
        templates[spec.template_id] += count
        distractors[len(referents(catalog[spec.scene].info, spec.category)) - 1] += count
        if plan.language is None and len(referents_of(spec, catalog[spec.scene].info)) > 1:
            ambiguous += count
            if plan.instructions.unique == "view" and (spec.scene, spec.category) not in exempt:
                shown_alone += count
    return PlanSummary(
        specs.total(),
        dict(categories.most_common()),
        templates=dict(sorted(templates.items())),
        ambiguous=ambiguous,
        shown_alone=shown_alone,
        distractors=dict(sorted(distractors.items())),
    )


@dataclass(frozen=True)
class OfferRow:
    """Objects of a category that can be the target of the planned episodes of a scene in a tier."""

    scene: str
    """Scene or layout."""
    tier: Tier
    category: str
    objects: int
    """Number of objects that a cell of the plan may name."""
    reachable: int
    """Number of objects with a start in the tier, whatever the start shows."""
    groups: int | None
    """Number of groups of objects that could be the target from one start; `None` if the plan names its targets."""


def offer_rows(plan: Plan, catalog: Catalog) -> list[OfferRow]:
    """Returns what each scene offers, ordered by scene, tier and category; omits layouts that the catalog lacks."""
    rows = []
    for cells in each_scene(plan, catalog):
        for tier in dict.fromkeys(tier for _, tier in cells.quota):
            splits = [split for split, each in cells.quota if each is tier]
            named = {target for split in splits for target in cells.pool(split, tier)}
            reachable = {target for split in splits for target in cells.permitted(split, tier)}
            for category in sorted({target.category for target in reachable}):
                ids = {each.instance_id for each in reachable if each.category == category}
                groups = None if cells.groups is None else sum(group <= ids for group in cells.groups[tier])
                objects = sum(each.category == category for each in named)
                rows.append(OfferRow(cells.scene.name, tier, category, objects, len(ids), groups))
    return rows
