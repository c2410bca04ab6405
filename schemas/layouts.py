"""Distributes the episodes of a family over its layouts, from the plan only: the layouts need not be built.

The family has an exact quota of episodes for each cell of split x tier. The episodes are distributed over the layouts
in turn, so two layouts of one kind differ by at most one episode, in total and in each cell. The two kinds are the
layouts of the unseen-scene splits, which are the last ones, and all others. Pure functions.

Design: docs/design/jobs.md#layouts-get-episodes-from-the-plan.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence

from pydantic import Field, InstanceOf

from schemas.scene_plan import ScenePlan
from schemas.support.apportion import apportion, webster_sequence
from schemas.terms import Split, Tier, layout_name, layout_number

LAYOUT_SEEDS = 20
"""Largest number of seeds that are tried for one layout."""

Cell = tuple[Split, Tier]
Cells = dict[Cell, int]
"""Number of episodes of each cell; cells without episodes are omitted."""


class LayoutPlan(ScenePlan):
    """Entry of one layout of a family. These entries replace the entry of the family; they are not written to files."""

    family: ScenePlan = Field(exclude=True)
    """Entry of the family."""
    places: Mapping[Cell, InstanceOf[range]] = Field(exclude=True)
    """Positions of the layout's episodes, by cell. The family has two sequences of episodes: those with seen categories
    and those with held-out categories. A position counts in the sequence to which the split of the cell belongs."""

    @property
    def quota(self) -> Cells:
        """Number of episodes of each cell in this layout."""
        return {cell: len(places) for cell, places in self.places.items()}

    @property
    def is_unseen(self) -> bool:
        """Whether only the unseen-scene splits use the layout."""
        return any(split.is_unseen_scene for split, _ in self.places)

    def as_scene(self) -> ScenePlan:
        """Returns the entry as that of a single scene, whose seed is the first seed of the layout."""
        return ScenePlan.model_construct(**{name: getattr(self, name) for name in ScenePlan.model_fields})

    @property
    def seeds(self) -> Sequence[int]:
        """Seeds to try, in order; no other layout of the family tries one of them."""
        stride = self.family.layouts or 1
        return range(self.seed, self.seed + LAYOUT_SEEDS * stride, stride)


def cross_quota(splits: Mapping[Split, float], tiers: Mapping[Tier, float], episodes: int) -> Cells:
    """Returns the exact quota of each cell of split x tier; cells without episodes are omitted."""
    order = iter(webster_sequence({key: share for key, share in tiers.items() if share > 0}, episodes))
    cells: Cells = {}
    for split, count in apportion({key: share for key, share in splits.items() if share > 0}, episodes).items():
        for _ in range(count):
            cell = split, next(order)
            cells[cell] = cells.get(cell, 0) + 1
    return cells


def layouts_of(scene: ScenePlan, splits: Mapping[Split, float], tiers: Mapping[Tier, float]) -> tuple[LayoutPlan, ...]:
    """Returns the entries of the layouts of a family that have episodes.

    Args:
        scene: entry of the family, with `layouts`.
        splits: fractions of the splits.
        tiers: fractions of the tiers.
    """
    layouts, unseen = scene.layouts or 1, unseen_layouts(scene, splits)
    dealt: list[dict[Cell, range]] = [{} for _ in range(layouts)]
    groups = {False: dealt[: layouts - unseen], True: dealt[layouts - unseen :]}
    turns, starts = dict.fromkeys(groups, 0), dict.fromkeys((False, True), 0)
    for (split, tier), count in cross_quota(splits, tiers, scene.episodes).items():
        group, start = groups[split.is_unseen_scene], starts[split.is_held_out]
        for place, cells in enumerate(group):
            numbers = range(start + (place - turns[split.is_unseen_scene]) % len(group), start + count, len(group))
            if numbers:
                cells[split, tier] = numbers
        turns[split.is_unseen_scene] += count
        starts[split.is_held_out] += count
    shared = {name: getattr(scene, name) for name in ScenePlan.model_fields}
    shared |= {"layouts": None, "unseen_layouts": None, "family": scene}
    shares = {is_unseen: {"splits": _splits_of_kind(splits, is_unseen)} for is_unseen in groups}
    return tuple(
        LayoutPlan.model_construct(
            **shared
            | shares[number >= layouts - unseen]
            | {"name": layout_name(scene.name, scene.seed + number), "seed": scene.seed + number}
            | {"episodes": sum(map(len, cells.values())), "places": cells}
        )
        for number, cells in enumerate(dealt)
        if cells
    )


def unseen_layouts(scene: ScenePlan, splits: Mapping[Split, float]) -> int:
    """Returns the number of layouts of a family that only the unseen-scene splits use."""
    share = sum(share for split, share in splits.items() if split.is_unseen_scene)
    layouts = scene.layouts or 1
    if share <= 0:
        return 0
    if scene.unseen_layouts is not None:
        return scene.unseen_layouts
    if share >= 1 - 1e-9:
        return layouts
    return min(max(1, round(layouts * share)), layouts - 1)


def layout_mistakes(scene: ScenePlan, splits: Mapping[Split, float]) -> Iterator[str]:
    """Yields the mistakes in the layouts of an entry of a plan.

    Args:
        scene: entry of a scene or of a family.
        splits: fractions of the splits that apply to it.
    """
    has_unseen = any(share > 0 and split.is_unseen_scene for split, share in splits.items())
    if scene.layouts is None or not has_unseen:
        is_layout = layout_number(scene.name) is not None
        if has_unseen and is_layout and not all(split.is_unseen_scene for split, share in splits.items() if share > 0):
            yield "one layout cannot have the splits test_unseen_scene* and others: set the shares of one kind to 0"
        if has_unseen and not is_layout:
            yield "the splits test_unseen_scene* need `layouts`: set their shares of this scene to 0"
        if scene.unseen_layouts is not None:
            yield "`unseen_layouts` has no use, because the shares of the splits test_unseen_scene* are 0: remove it"
        return
    unseen = unseen_layouts(scene, splits)
    unseen_episodes = _unseen_episodes(splits, scene.episodes)
    for name, episodes, layouts in (
        ("test_unseen_scene*", unseen_episodes, unseen),
        ("other", scene.episodes - unseen_episodes, scene.layouts - unseen),
    ):
        if episodes and not 0 < layouts <= episodes:
            yield f"{episodes} episodes of the {name} splits need 1 to {episodes} layouts, not {layouts}"


def with_episodes(scene: ScenePlan, splits: Mapping[Split, float], episodes: int) -> ScenePlan:
    """Returns an entry with a different number of episodes; a family with too few episodes gets fewer layouts."""
    if scene.layouts is None:
        return scene.model_copy(update={"episodes": episodes})
    held_back, unseen = _unseen_episodes(splits, episodes), unseen_layouts(scene, splits)
    fewer = min(unseen, held_back)
    layouts = fewer + min(scene.layouts - unseen, episodes - held_back)
    return scene.model_copy(update={"episodes": episodes, "layouts": layouts, "unseen_layouts": fewer or None})


def _splits_of_kind(splits: Mapping[Split, float], is_unseen: bool) -> dict[Split, float]:
    kept = {split: share for split, share in splits.items() if split.is_unseen_scene is is_unseen and share > 0}
    total = sum(kept.values())
    return {split: share / total for split, share in kept.items()}


def _unseen_episodes(splits: Mapping[Split, float], episodes: int) -> int:
    counts = apportion({key: share for key, share in splits.items() if share > 0}, episodes)
    return sum(count for split, count in counts.items() if split.is_unseen_scene)
