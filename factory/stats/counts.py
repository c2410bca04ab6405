"""Counts categories and templates, and the target instances shared by splits. Pure functions; no I/O."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence

from factory.stats import paper
from factory.stats.model import CountRow, OverlapRow, Published
from factory.stats.rollouts import ALL
from schemas.dataset.rows import EpisodeSummary
from schemas.instruction.language import OOD_TEMPLATES, TEMPLATES, TRAIN_TEMPLATES, needs_colour
from schemas.plan import Plan
from schemas.terms import Split, family_of

Episodes = Sequence[EpisodeSummary]


def count_categories(episodes: Episodes, plan: Plan) -> tuple[CountRow, ...]:
    """Returns one row for each category of the plan, the most frequent first (paper Fig. 6)."""
    kinds = {name: "held out" for scene in plan.scenes for name in scene.categories.held_out}
    kinds |= {name: "seen" for scene in plan.scenes for name in scene.categories.seen}
    found = Counter(row.target_category for row in episodes)
    names = sorted(kinds.keys() | found.keys(), key=lambda name: (-found[name], name))
    return _rows(found, {name: kinds.get(name, "not in the plan") for name in names}, paper.CATEGORIES)


def share_of_largest(rows: Sequence[CountRow], count: int) -> float | None:
    """Returns the share of the `count` most frequent rows, or `None` without episodes."""
    total = sum(row.n for row in rows)
    return sum(sorted((row.n for row in rows), reverse=True)[:count]) / total if total else None


def count_templates(episodes: Episodes) -> tuple[CountRow, ...]:
    """Returns one row for each template, in the paper's order (paper Fig. 12)."""
    found = Counter(row.template_id for row in episodes)
    kinds = {name: _kind(name) for name in TEMPLATES}
    kinds |= dict.fromkeys(sorted(found.keys() - TEMPLATES.keys()), "unknown")
    return _rows(found, kinds, paper.TEMPLATE_COUNTS)


def overlaps(episodes: Episodes, plan: Plan) -> tuple[OverlapRow, ...]:
    """Returns the overlap of the target instances of each split with training, for each scene and for all scenes."""
    rows = [row for scene in plan.scenes for row in _overlaps_in(scene.name, episodes)]
    return (*rows, *_overlaps_in(ALL, episodes))


def _rows(found: Counter[str], kinds: Mapping[str, str], published: Mapping[str, Published]) -> tuple[CountRow, ...]:
    total = found.total()
    return tuple(
        CountRow(
            group=name,
            kind=kind,
            n=found[name],
            share=found[name] / total if total else None,
            paper=published.get(name),
        )
        for name, kind in kinds.items()
    )


def _kind(template_id: str) -> str:
    pool = "train" if template_id in TRAIN_TEMPLATES else "paraphrase" if template_id in OOD_TEMPLATES else "unknown"
    return f"{pool}, colour" if needs_colour(template_id) else pool


def _overlaps_in(scene: str, episodes: Episodes) -> Iterator[OverlapRow]:
    here = [row for row in episodes if scene in (ALL, family_of(row.scene))]
    trained = {(row.scene, row.target_id) for row in here if row.split is Split.TRAIN_ID}
    for split in Split:
        if split in (Split.TRAIN_ID, Split.TEST_FALSE_PREMISE):  # no object fits a false premise
            continue
        named = [(row.scene, row.target_id) for row in here if row.split is split]
        if split.is_unseen_scene and not named:
            continue
        targets = set(named)
        shared = targets & trained
        yield OverlapRow(
            scene=scene,
            split=split,
            targets=len(targets),
            shared=len(shared),
            share=len(shared) / len(targets) if targets else None,
            episodes=len(named),
            episodes_on_shared=sum(target in shared for target in named),
        )
