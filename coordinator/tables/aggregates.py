"""Aggregates the rows of a dataset's tables for its metadata and card. Reads and writes no file."""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from typing import Protocol, TypeVar

from schemas.terms import FailReason


class _Refused(Protocol):
    scene: str
    reason: str


Failure = TypeVar("Failure", bound=_Refused)
_TASK_FAILURES = frozenset(str(reason) for reason in FailReason if reason.is_task_failure)


@dataclass
class EpisodeSums:
    """Sums over a set of episodes."""

    episodes: int = 0
    """Number of episodes."""
    steps: int = 0
    """Sum of steps."""
    spawn_dist_m: float = 0.0
    """Sum of spawn distances, metres."""
    trajectory_length_m: float = 0.0
    """Sum of trajectory lengths, metres."""
    final_ne_m: float = 0.0
    """Sum of final navigation errors, metres."""

    def add(
        self, episodes: int, steps: int, spawn_dist_m: float, trajectory_length_m: float, final_ne_m: float
    ) -> None:
        """Adds sums over further episodes."""
        self.episodes += episodes
        self.steps += steps
        self.spawn_dist_m += spawn_dist_m
        self.trajectory_length_m += trajectory_length_m
        self.final_ne_m += final_ne_m


@dataclass
class TableAggregates:
    """Aggregates of the written rows; the memory use is a few hundred bytes per episode."""

    digests: list[tuple[str, str]] = field(default_factory=list)
    """Episode id and content digest of each episode."""
    counts: Counter[tuple[str, str, str]] = field(default_factory=Counter)
    """Number of episodes by (scene, split, tier)."""
    categories: Counter[str] = field(default_factory=Counter)
    """Number of episodes by target category."""
    scenes: defaultdict[str, EpisodeSums] = field(default_factory=lambda: defaultdict(EpisodeSums))
    tiers: defaultdict[str, EpisodeSums] = field(default_factory=lambda: defaultdict(EpisodeSums))
    refused: Counter[str] = field(default_factory=Counter)
    """Number of task failures by scene."""
    renderers: set[str] = field(default_factory=set)
    makers: set[tuple[str, str, str]] = field(default_factory=set)
    """Renderer, package versions as JSON, and CPU of the workers."""

    def count_failures(self, rows: Iterable[Failure]) -> Iterator[Failure]:
        """Yields the rows unchanged and counts the task failures."""
        for row in rows:
            self.refused[row.scene] += row.reason in _TASK_FAILURES
            yield row
