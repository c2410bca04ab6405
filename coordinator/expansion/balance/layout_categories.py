"""Gives each cell of a layout its exact quota of categories, from the plan only. Reads no scene.

A family has a sequence of seen categories and a sequence of held-out categories. A sequence consists of random
permutations of its categories, so their numbers of episodes differ by at most one. The plan assigns positions
in these sequences to each layout; the episodes of a layout have the categories at its positions.
"""

from __future__ import annotations

from collections import Counter
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from coordinator.expansion.cells import Cell
from coordinator.expansion.scene_cells import categories_of
from schemas.layouts import LayoutPlan
from schemas.plan import Plan, ScenePlan

_SEQUENCE_STREAM = 4


def layout_categories(plan: Plan, scene: ScenePlan) -> dict[Cell, Counter[str]]:
    """Returns the number of episodes of each category in each cell of a layout; empty for a scene that is not a layout,
    and for a plan that is balanced over instances."""
    if not isinstance(scene, LayoutPlan) or plan.balance == "instances":
        return {}
    number = plan.scenes.index(scene.family)
    found: dict[Cell, Counter[str]] = {}
    for (split, tier), places in scene.places.items():
        names = categories_of(scene, split)
        seed = plan.seed, _SEQUENCE_STREAM, number, int(split.is_held_out)
        sequence = _sequence(seed, len(names), scene.family.episodes)
        found[split, tier] = Counter(names[int(sequence[place])] for place in places)
    return found


def planned_categories(plan: Plan) -> Counter[str]:
    """Returns the number of episodes of each category in the layouts of a plan; empty for a plan that is balanced over
    instances, whose categories depend on the objects of the layouts."""
    return sum((quota for part in plan.parts for quota in layout_categories(plan, part).values()), Counter())


@lru_cache(maxsize=8)
def _sequence(seed: tuple[int, ...], categories: int, episodes: int) -> NDArray[np.int16]:
    """Returns a random sequence of category indices, with at least one entry for each episode of a family."""
    rng = np.random.default_rng(np.random.SeedSequence(seed))
    rounds = np.tile(np.arange(categories, dtype=np.int16), (-(-episodes // categories), 1))
    return rng.permuted(rounds, axis=1).ravel()
