"""What the rows of a dataset's tables add up to while they are written, for its description and its card. Pure."""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from typing import Protocol, TypeVar

from schemas.terms import FailReason

__all__ = ["EpisodeSums", "TableAggregates"]


class _Refused(Protocol):
    scene: str
    reason: str


Failure = TypeVar("Failure", bound=_Refused)
_OF_THE_WORLD = frozenset(str(reason) for reason in FailReason if reason.is_task_failure)


@dataclass
class EpisodeSums:
    """Sums over a set of episodes."""

    episodes: int = 0
    steps: int = 0
    spawn_dist_m: float = 0.0
    trajectory_length_m: float = 0.0
    final_ne_m: float = 0.0

    def add(
        self, episodes: int, steps: int, spawn_dist_m: float, trajectory_length_m: float, final_ne_m: float
    ) -> None:
        """Adds the sums over more episodes."""
        self.episodes += episodes
        self.steps += steps
        self.spawn_dist_m += spawn_dist_m
        self.trajectory_length_m += trajectory_length_m
        self.final_ne_m += final_ne_m


@dataclass
class TableAggregates:
    """What the rows tell while they pass by; grows by some hundred bytes an episode."""

    digests: list[tuple[str, str]] = field(default_factory=list)
    counts: Counter[tuple[str, str, str]] = field(default_factory=Counter)
    """Episodes by (scene, split, tier)."""
    categories: Counter[str] = field(default_factory=Counter)
    scenes: defaultdict[str, EpisodeSums] = field(default_factory=lambda: defaultdict(EpisodeSums))
    tiers: defaultdict[str, EpisodeSums] = field(default_factory=lambda: defaultdict(EpisodeSums))
    refused: Counter[str] = field(default_factory=Counter)
    """Attempts that the world refused, by scene."""
    renderers: set[str] = field(default_factory=set)

    def watch_failures(self, rows: Iterable[Failure]) -> Iterator[Failure]:
        """Yields the rows and counts those that the world refused."""
        for row in rows:
            self.refused[row.scene] += row.reason in _OF_THE_WORLD
            yield row
