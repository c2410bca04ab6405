"""Counts categories, templates, target instances shared by splits, and attempts by scene, tier and cell of the plan.

An attempt counts if it ended with success or a failure of the task. Other failures, such as crashes and expired leases,
are counted by reason only. Pure functions; no I/O.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence

from coordinator.expansion.cells import cells
from factory.stats import paper
from factory.stats.measures import share_of
from factory.stats.rollouts import ALL
from factory.stats.statistics import AttemptRow, CellRow, CountRow, OverlapRow, Published, Share
from schemas.dataset.rows import EpisodeSummary, FailedAttempt
from schemas.instruction.templates import OOD_TEMPLATES, TEMPLATES, TRAIN_TEMPLATES, needs_colour
from schemas.plan import Plan
from schemas.terms import FailReason, Split, Tier, family_of

Episodes = Sequence[EpisodeSummary]


def count_categories(episodes: Episodes, plan: Plan) -> tuple[CountRow, ...]:
    """Returns one row for each category of the plan, the most frequent first (paper Fig. 6)."""
    kinds = {name: "held out" for scene in plan.scenes for name in scene.categories.held_out}
    kinds |= {name: "seen" for scene in plan.scenes for name in scene.categories.seen}
    categories = Counter(row.target_category for row in episodes)
    names = sorted(kinds.keys() | categories.keys(), key=lambda name: (-categories[name], name))
    return _rows(categories, {name: kinds.get(name, "not in the plan") for name in names}, paper.CATEGORIES)


def share_of_largest(rows: Sequence[CountRow], count: int) -> float | None:
    """Returns the share of the `count` most frequent rows, or `None` without episodes."""
    total = sum(row.n for row in rows)
    return sum(sorted((row.n for row in rows), reverse=True)[:count]) / total if total else None


def count_templates(episodes: Episodes) -> tuple[CountRow, ...]:
    """Returns one row for each template, in the paper's order (paper Fig. 12)."""
    templates = Counter(row.template_id for row in episodes)
    kinds = {name: _kind(name) for name in TEMPLATES}
    kinds |= dict.fromkeys(sorted(templates.keys() - TEMPLATES.keys()), "unknown")
    return _rows(templates, kinds, paper.TEMPLATE_COUNTS)


def overlaps(episodes: Episodes, plan: Plan) -> tuple[OverlapRow, ...]:
    """Returns the overlap of the target instances of each split with training, for each scene and for all scenes."""
    rows = [row for scene in plan.scenes for row in _overlaps_in(scene.name, episodes)]
    return (*rows, *_overlaps_in(ALL, episodes))


def _rows(rows: Counter[str], kinds: Mapping[str, str], published: Mapping[str, Published]) -> tuple[CountRow, ...]:
    total = rows.total()
    return tuple(
        CountRow(
            group=name,
            kind=kind,
            n=rows[name],
            share=rows[name] / total if total else None,
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


AttemptSummary = EpisodeSummary | FailedAttempt
# crashes and expired leases describe machines, not scenes, so they do not reduce the success rate
_TASK_FAILURES = frozenset(str(reason) for reason in FailReason if reason.is_task_failure)


def attempt_rows(
    episodes: Sequence[EpisodeSummary], failures: Sequence[FailedAttempt], scenes: Iterable[str]
) -> tuple[AttemptRow, ...]:
    """Returns one row for all attempts, and rows by scene, by tier, and by scene and tier."""
    names = list(scenes)
    kinds: list[tuple[Iterable[str], Callable[[AttemptSummary], str]]] = [
        (names, lambda row: family_of(row.scene)),
        (Tier, lambda row: row.spawn_tier),
        (
            [f"{name} / {tier}" for name in names for tier in Tier],
            lambda row: f"{family_of(row.scene)} / {row.spawn_tier}",
        ),
        ([ALL], lambda _: ALL),
    ]
    return tuple(row for groups, name_of in kinds for row in _group_rows(episodes, failures, groups, name_of))


def first_of_near_and_mid(rows: Iterable[AttemptRow], scene: str) -> Share:
    """Returns the share of first attempts from near and mid starts of a scene that succeeded.

    This share is compared with the published success rates, because 98.8 % of the paper's episodes are near or mid.
    """
    groups = {f"{scene} / {tier}" for tier in (Tier.NEAR, Tier.MID)}
    shares = [row.first for row in rows if row.group in groups]
    return share_of(sum(share.count for share in shares), sum(share.of for share in shares))


def cell_rows(
    episodes: Sequence[EpisodeSummary], failures: Sequence[FailedAttempt] | None, plans: Sequence[Plan]
) -> tuple[CellRow, ...]:
    """Returns quota, episodes and attempts of each cell (scene x split x tier) that is in a plan or has episodes."""
    archived = Counter((family_of(row.scene), str(row.split), str(row.spawn_tier)) for row in episodes)
    failed = Counter(
        (family_of(row.scene), str(row.split), str(row.spawn_tier))
        for row in failures or ()
        if row.reason in _TASK_FAILURES
    )
    planned: Counter[tuple[str, str, str]] = Counter()
    for plan in plans:
        for scene in plan.scenes:
            for (split, tier), count in cells(plan, scene).items():
                planned[family_of(scene.name), str(split), str(tier)] += count
    order = dict.fromkeys([*planned, *sorted(archived.keys() | failed.keys())])
    return tuple(
        CellRow(
            scene=key[0],
            split=key[1],
            tier=key[2],
            planned=planned[key],
            archived=archived[key],
            attempts=None if failures is None else archived[key] + failed[key],
        )
        for key in order
    )


def _group_rows(
    episodes: Sequence[EpisodeSummary],
    failures: Sequence[FailedAttempt],
    groups: Iterable[str],
    name_of: Callable[[AttemptSummary], str],
) -> list[AttemptRow]:
    succeeded: dict[str, list[EpisodeSummary]] = {str(name): [] for name in groups}
    failed: dict[str, list[FailedAttempt]] = {}
    for row in episodes:
        succeeded.setdefault(name_of(row), []).append(row)
    for failure in failures:
        succeeded.setdefault(name_of(failure), [])
        failed.setdefault(name_of(failure), []).append(failure)
    return [_row(name, succeeded[name], failed.get(name, [])) for name in succeeded]


def _row(name: str, succeeded: list[EpisodeSummary], failed: list[FailedAttempt]) -> AttemptRow:
    reasons = Counter(row.reason for row in failed)
    decided = [row for row in failed if row.reason in _TASK_FAILURES]
    attempts = len(succeeded) + len(decided)
    first_succeeded = sum(row.attempt == 1 for row in succeeded)
    first_failed = sum(row.attempt == 1 for row in decided)
    return AttemptRow(
        group=name,
        attempts=attempts,
        success=share_of(len(succeeded), attempts),
        first=share_of(first_succeeded, first_succeeded + first_failed),
        collision=share_of(reasons[FailReason.COLLISION], attempts),
        timeout=share_of(reasons[FailReason.TIMEOUT], attempts),
        reasons=dict(sorted(reasons.items())),
        paper=paper.ATTEMPTS.get(name),
    )
