"""Counts attempts: success, collision and timeout by scene and tier, and the attempts of each cell of the plan.

An attempt counts if it ended with success or a failure of the task. Other failures, such as crashes and expired leases,
are counted by reason only.
Pure functions; no I/O.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Sequence

from coordinator.expansion.cells import cells
from factory.stats import paper
from factory.stats.measures import share_of
from factory.stats.model import AttemptRow, CellRow, Share
from factory.stats.rollouts import ALL
from schemas.dataset.rows import EpisodeSummary, FailedAttempt
from schemas.plan import Plan
from schemas.terms import FailReason, Tier, family_of

AttemptSummary = EpisodeSummary | FailedAttempt
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
    return tuple(row for groups, name_of in kinds for row in _rows(episodes, failures, groups, name_of))


def first_of_near_and_mid(rows: Iterable[AttemptRow], scene: str) -> Share:
    """Returns the share of first attempts from near and mid starts of a scene that succeeded.

    This share is compared with the published success rates, because 98.8 % of the paper's episodes are near or mid.
    """
    groups = {f"{scene} / {tier}" for tier in (Tier.NEAR, Tier.MID)}
    found = [row.first for row in rows if row.group in groups]
    return share_of(sum(share.count for share in found), sum(share.of for share in found))


def cell_rows(
    episodes: Sequence[EpisodeSummary], failures: Sequence[FailedAttempt] | None, plan: Plan
) -> tuple[CellRow, ...]:
    """Returns quota, episodes and attempts of each cell (scene x split x tier) that is in the plan or has episodes."""
    archived = Counter((family_of(row.scene), str(row.split), str(row.spawn_tier)) for row in episodes)
    failed = Counter(
        (family_of(row.scene), str(row.split), str(row.spawn_tier))
        for row in failures or ()
        if row.reason in _TASK_FAILURES
    )
    planned = {
        (scene.name, str(split), str(tier)): count
        for scene in plan.scenes
        for (split, tier), count in cells(plan, scene).items()
    }
    order = dict.fromkeys([*planned, *sorted(archived.keys() | failed.keys())])
    return tuple(
        CellRow(
            scene=key[0],
            split=key[1],
            tier=key[2],
            planned=planned.get(key, 0),
            archived=archived[key],
            attempts=None if failures is None else archived[key] + failed[key],
        )
        for key in order
    )


def _rows(
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
