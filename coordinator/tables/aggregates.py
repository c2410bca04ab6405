"""Aggregates the rows of a dataset's tables for its metadata and card. Reads and writes no file."""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from typing import Any, Self

import pyarrow as pa

from schemas.terms import FailReason, family_of

_TASK_FAILURES = frozenset(str(reason) for reason in FailReason if reason.is_task_failure)
_SUMS = ("num_steps", "spawn_dist_m", "trajectory_length_m", "final_ne_m")
_CELL = ["scene", "split", "spawn_tier"]
_MAKER = ["renderer", "software", "cpu"]


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

    def add(self, other: EpisodeSums) -> None:
        self.episodes += other.episodes
        self.steps += other.steps
        self.spawn_dist_m += other.spawn_dist_m
        self.trajectory_length_m += other.trajectory_length_m
        self.final_ne_m += other.final_ne_m


@dataclass
class TableAggregates:
    """Aggregates of rows of both tables; the memory use does not depend on the number of rows."""

    rows: int = 0
    """Number of rows."""
    counts: Counter[tuple[str, str, str]] = field(default_factory=Counter)
    """Number of episodes by (scene, split, tier); a family counts as one scene here and below."""
    categories: Counter[str] = field(default_factory=Counter)
    """Number of episodes by target category."""
    scenes: defaultdict[str, EpisodeSums] = field(default_factory=lambda: defaultdict(EpisodeSums))
    tiers: defaultdict[str, EpisodeSums] = field(default_factory=lambda: defaultdict(EpisodeSums))
    refused: Counter[str] = field(default_factory=Counter)
    """Number of task failures by scene."""
    renderers: set[str] = field(default_factory=set)
    makers: set[tuple[str, str, str]] = field(default_factory=set)
    """Renderer, package versions as JSON, and CPU of the workers."""

    @classmethod
    def total(cls, parts: Iterable[TableAggregates]) -> Self:
        """Returns the aggregates of all rows of some parts; the order of the parts determines rounding errors."""
        total = cls()
        for part in parts:
            total.rows += part.rows
            total.counts.update(part.counts)
            total.categories.update(part.categories)
            total.refused.update(part.refused)
            total.renderers |= part.renderers
            total.makers |= part.makers
            for ours, theirs in ((total.scenes, part.scenes), (total.tiers, part.tiers)):
                for key, sums in theirs.items():
                    ours[key].add(sums)
        return total


def aggregate_episodes(table: pa.Table) -> TableAggregates:
    """Returns the aggregates of rows of `metadata.parquet`."""
    totals = TableAggregates(rows=len(table), renderers=set(table["renderer"].unique().to_pylist()))
    totals.makers.update((row["renderer"], row["software"], row["cpu"]) for row in _sums(table, _MAKER, ()))
    for row in _sums(table, ["target_category"], ()):
        totals.categories[row["target_category"]] = row["count_all"]
    for row in _sums(table, _CELL, ()):
        totals.counts[family_of(row["scene"]), row["split"], row["spawn_tier"]] += row["count_all"]
    for key, sums in (("scene", totals.scenes), ("spawn_tier", totals.tiers)):
        for row in _sums(table, [key], _SUMS):
            of_row = EpisodeSums(row["count_all"], *(row[f"{name}_sum"] for name in _SUMS))
            sums[family_of(row[key])].add(of_row)
    return totals


def aggregate_failures(table: pa.Table) -> TableAggregates:
    """Returns the aggregates of rows of `attempts.parquet`."""
    totals = TableAggregates(rows=len(table))
    for row in _sums(table, ["scene", "reason"], ()):
        totals.refused[family_of(row["scene"])] += row["count_all"] * (row["reason"] in _TASK_FAILURES)
    return totals


def _sums(table: pa.Table, keys: list[str], columns: Sequence[str]) -> list[dict[str, Any]]:
    """Returns row counts and column sums by key; with one thread, so floating-point sums are reproducible."""
    grouped = table.group_by(keys, use_threads=False)
    sums: list[dict[str, Any]] = grouped.aggregate(
        [*((name, "sum") for name in columns), ([], "count_all")]
    ).to_pylist()
    return sums
