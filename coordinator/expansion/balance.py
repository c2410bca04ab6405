"""Distributes episodes over categories: equal totals for scenes, exact quotas for the layouts of a family.

For scenes, no other distribution has a smaller sum of squared totals. For a family, the quotas follow from the plan
only: the family has a sequence of seen and one of held-out categories, each made of random permutations, and the plan
assigns positions in them to its layouts. Reads no scene; `level` draws no random numbers.

Design: docs/design/jobs.md#equal-shares-of-categories.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from coordinator.expansion.cells import Cell
from coordinator.expansion.scene_cells import SceneCells, categories_of
from schemas.layouts import LayoutPlan
from schemas.plan import Plan, ScenePlan

Shares = dict[int, Counter[str]]
"""Number of episodes by place and category; a place is one cell of one scene."""


def category_quotas(scenes: Sequence[SceneCells]) -> dict[str, dict[Cell, Counter[str]]]:
    """Returns the number of episodes of each category in each cell, by name of the scene.

    The cells of one split and tier are levelled together over all scenes, starting from the totals of the splits and
    tiers that were levelled before. Every split and tier thus has even categories as far as possible. At the end all
    cells are levelled together.
    """
    places = [(scene, cell) for scene in scenes for cell in scene.quota]
    options = [sorted({target.category for target in scene.pool(*cell)}) for scene, cell in places]
    shares: Shares = {}
    totals: Counter[str] = Counter()
    for group in dict.fromkeys(cell for _, cell in places):
        within = [number for number, (_, cell) in enumerate(places) if cell == group]
        for number in within:
            scene, cell = places[number]
            shares[number] = _even(scene.quota[cell], options[number], totals)
            totals.update(shares[number])
        level({number: shares[number] for number in within}, options, totals)
    level(shares, options, totals)
    quotas: dict[str, dict[Cell, Counter[str]]] = {}
    for number, (scene, cell) in enumerate(places):
        quotas.setdefault(scene.scene.name, {})[cell] = shares[number]
    return quotas


def level(shares: Mapping[int, Counter[str]], options: Sequence[Sequence[str]], totals: Counter[str]) -> None:
    """Levels the totals by exchanging categories within places. Changes `shares` and `totals`.

    The sum of squared totals is minimal when no chain of exchanges leads from a category to one with at least two
    episodes fewer (Harvey, Ladner, Lovasz, Tamir: Semi-matchings for bipartite graphs and load balancing, 2006).

    Args:
        shares: places in which categories may be exchanged.
        options: categories of each place.
        totals: number of episodes of each category, including other places.
    """
    names = sorted({name for place in shares for name in options[place]})
    while any(_lower(high, shares, options, totals) for high in sorted(names, key=lambda name: -totals[name])):
        pass


def _even(count: int, options: Sequence[str], totals: Counter[str]) -> Counter[str]:
    """Distributes `count` episodes evenly; the categories with the lowest totals get the remainder, one each."""
    each, rest = divmod(count, len(options))
    ranked = sorted(options, key=lambda name: (totals[name], name))
    return Counter({name: each + (rank < rest) for rank, name in enumerate(ranked)})


def _lower(
    high: str, shares: Mapping[int, Counter[str]], options: Sequence[Sequence[str]], totals: Counter[str]
) -> bool:
    """Moves episodes from category `high` to the category with the lowest total that a chain of exchanges reaches.

    Returns whether it moved any episode.
    """
    takes_from = _chains(high, shares, options)
    low = min(takes_from, key=lambda name: (totals[name], name), default=high)
    amount = (totals[high] - totals[low]) // 2
    if amount < 1:
        return False
    chain = []
    taker = low
    while taker != high:
        giver, place = takes_from[taker]
        chain.append((giver, taker, place))
        amount = min(amount, shares[place][giver])
        taker = giver
    for giver, taker, place in chain:
        shares[place].subtract({giver: amount})
        shares[place].update({taker: amount})
    totals.subtract({high: amount})
    totals.update({low: amount})
    return True


def _chains(
    high: str, shares: Mapping[int, Counter[str]], options: Sequence[Sequence[str]]
) -> dict[str, tuple[str, int]]:
    """Returns the categories that chains of exchanges from category `high` reach.

    Maps each of them to the category that precedes it in the chain, which gives it episodes, and to the place of that
    exchange.
    """
    takes_from: dict[str, tuple[str, int]] = {}
    front = [high]
    while front:
        reached: list[str] = []
        for giver in front:
            for place in sorted(shares, key=lambda place: -shares[place][giver]):
                if shares[place][giver] > 0:
                    new = [name for name in options[place] if name != high and name not in takes_from]
                    takes_from |= dict.fromkeys(new, (giver, place))
                    reached += new
        front = reached
    return takes_from


_SEQUENCE_STREAM = 4


def layout_categories(plan: Plan, scene: ScenePlan) -> dict[Cell, Counter[str]]:
    """Returns the number of episodes of each category in each cell of a layout; empty for a scene that is not a layout,
    and for a plan that is balanced over instances."""
    if not isinstance(scene, LayoutPlan) or plan.balance == "instances":
        return {}
    number = plan.scenes.index(scene.family)
    categories: dict[Cell, Counter[str]] = {}
    for (split, tier), places in scene.places.items():
        names = categories_of(scene, split)
        seed = plan.seed, _SEQUENCE_STREAM, number, int(split.is_held_out)
        sequence = _sequence(seed, len(names), scene.family.episodes)
        categories[split, tier] = Counter(names[int(sequence[place])] for place in places)
    return categories


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
