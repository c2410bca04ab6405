"""What became of the attempts: success, collision and timeout by scene and tier, and what each cell took. Pure.

An attempt is one that the world decided: crashes, expired leases and the like are counted by reason only.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Sequence

from coordinator.expansion.cells import cells
from factory.stats import paper
from factory.stats.measures import share_of
from factory.stats.model import AttemptRow, CellRow
from factory.stats.rollouts import ALL
from schemas.dataset import EpisodeSummary, FailedAttempt
from schemas.plan import Plan
from schemas.terms import FailReason, Tier

__all__ = ["attempt_rows", "cell_rows"]

Tried = EpisodeSummary | FailedAttempt
_OF_THE_WORLD = frozenset(str(reason) for reason in FailReason if reason.is_task_failure)


def attempt_rows(
    episodes: Sequence[EpisodeSummary], failures: Sequence[FailedAttempt], scenes: Iterable[str]
) -> tuple[AttemptRow, ...]:
    """Returns rows by scene, by tier, by both, and one of all."""
    names = list(scenes)
    kinds: list[tuple[Iterable[str], Callable[[Tried], str]]] = [
        (names, lambda row: row.scene),
        (Tier, lambda row: row.spawn_tier),
        ([f"{name} / {tier}" for name in names for tier in Tier], lambda row: f"{row.scene} / {row.spawn_tier}"),
        ([ALL], lambda _: ALL),
    ]
    return tuple(row for groups, name_of in kinds for row in _rows(episodes, failures, groups, name_of))


def cell_rows(
    episodes: Sequence[EpisodeSummary], failures: Sequence[FailedAttempt] | None, plan: Plan
) -> tuple[CellRow, ...]:
    """Returns quota, episodes and attempts of each cell of scene x split x tier that the plan or the data has."""
    archived = Counter((row.scene, str(row.split), str(row.spawn_tier)) for row in episodes)
    lost = Counter(
        (row.scene, str(row.split), str(row.spawn_tier)) for row in failures or () if row.reason in _OF_THE_WORLD
    )
    planned = {
        (scene.name, str(split), str(tier)): count
        for scene in plan.scenes
        for (split, tier), count in cells(plan, scene).items()
    }
    order = dict.fromkeys([*planned, *sorted(archived.keys() | lost.keys())])
    return tuple(
        CellRow(
            scene=key[0],
            split=key[1],
            tier=key[2],
            planned=planned.get(key, 0),
            archived=archived[key],
            attempts=None if failures is None else archived[key] + lost[key],
        )
        for key in order
    )


def _rows(
    episodes: Sequence[EpisodeSummary],
    failures: Sequence[FailedAttempt],
    groups: Iterable[str],
    name_of: Callable[[Tried], str],
) -> list[AttemptRow]:
    won: dict[str, list[EpisodeSummary]] = {str(name): [] for name in groups}
    lost: dict[str, list[FailedAttempt]] = {}
    for row in episodes:
        won.setdefault(name_of(row), []).append(row)
    for failure in failures:
        won.setdefault(name_of(failure), [])
        lost.setdefault(name_of(failure), []).append(failure)
    return [_row(name, won[name], lost.get(name, [])) for name in won]


def _row(name: str, won: list[EpisodeSummary], lost: list[FailedAttempt]) -> AttemptRow:
    reasons = Counter(row.reason for row in lost)
    decided = [row for row in lost if row.reason in _OF_THE_WORLD]
    attempts = len(won) + len(decided)
    first_won = sum(row.attempt == 1 for row in won)
    first_lost = sum(row.attempt == 1 for row in decided)
    return AttemptRow(
        group=name,
        attempts=attempts,
        success=share_of(len(won), attempts),
        first=share_of(first_won, first_won + first_lost),
        collision=share_of(reasons[FailReason.COLLISION], attempts),
        timeout=share_of(reasons[FailReason.TIMEOUT], attempts),
        reasons=dict(sorted(reasons.items())),
        paper=paper.ATTEMPTS.get(name),
    )
