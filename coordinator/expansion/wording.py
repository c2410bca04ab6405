"""Selects the templates that a plan permits for a target, and the targets that have a permitted template."""

from __future__ import annotations

from collections import Counter

from schemas.instruction.language import FROM_START, needs_colour, say_category, templates_for
from schemas.instruction.referents import referents
from schemas.plan import Plan, ScenePlan
from schemas.scene import SceneInfo, Target
from schemas.terms import Split


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
        found = templates_for(split, colour)
        if not self._needs_unique(target.category):
            return found
        return tuple(
            each for each in found if (target.category, colour if needs_colour(each) else None) in self._unique
        )

    def _needs_unique(self, category: str) -> bool:
        return self._ambiguous is not None and category not in self._ambiguous

    @property
    def unique(self) -> tuple[str, ...]:
        """Words that fit exactly one target of the scene, such as `red chair`; empty if the plan does not need them."""
        return tuple(sorted(f"{colour or ''} {say_category(name)}".strip() for name, colour in self._unique))
