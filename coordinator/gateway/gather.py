"""Copies the episodes that gateways store into the dataset of the core and records them there.

The module compares each copy with the ledger. It runs without a coordinator, does not delete files of a gateway, and
can be repeated after an interruption.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from datetime import datetime
from functools import partial
from pathlib import Path

from sqlalchemy import Engine, select
from sqlalchemy.engine import Connection

from coordinator.archive.contract import Archive
from coordinator.archive.opening import open_archive
from coordinator.ledger.archived import gateways_by_episode, record_at_core
from coordinator.ledger.claims import has_open_jobs
from coordinator.ledger.database.engine import open_writer
from coordinator.ledger.outcomes import lose
from coordinator.ledger.reading.reader import require_sound
from coordinator.ledger.tables import episodes
from coordinator.packing import pack_settled
from coordinator.recovery.repair_dataset import RepairInput
from coordinator.tables.checkpoint import write_checkpoint
from coordinator.tables.split_tables import write_split_tables
from schemas.base import Model
from schemas.errors import UsageError, WorldError
from schemas.job import episode_id
from schemas.plan import Plan
from schemas.storage.dataset_files import EPISODES
from schemas.storage.object_path import ObjectPath
from schemas.storage.place import FilePlace, digest_of
from schemas.storage.shard_index import episode_place
from schemas.storage.shards import MAX_SHARD_EPISODES, range_of
from schemas.support.shell import quoted

_COPY_BYTES = 1 << 20
ProgressCallback = Callable[[int, int], None]


class Missing(Model):
    """Episode without an intact file in any of the directories."""

    episode: str
    """Episode id."""
    gateway: str
    """Gateway that stores the episode according to the ledger."""
    why: str
    """Reason, per directory."""


class GatherReport(Model):
    """Result of `gather`."""

    dataset: str
    """Root of the dataset."""
    run: str
    """Name of the run."""
    gathered: int
    """Number of episodes copied by this call."""
    missing: tuple[Missing, ...]
    """Episodes that were not found."""
    requeued: bool
    """Whether the missing episodes were returned to the queue, to be collected again."""
    episodes: int
    """Number of episodes in the dataset."""
    planned: int
    """Number of episodes of the plan."""


@dataclass(frozen=True)
class _Wanted:
    """Ledger record of an episode at a gateway."""

    index: int
    gateway: str
    sha256: str
    size: int


def gather(
    dataset: RepairInput,
    sources: Sequence[Path],
    now: datetime,
    *,
    requeue_missing: bool = False,
    on_progress: ProgressCallback = lambda _done, _all: None,
    shard_episodes: int = MAX_SHARD_EPISODES,
) -> GatherReport:
    """Copies the episodes that are found in directories of gateways into the dataset.

    Args:
        dataset: dataset of the core.
        sources: directories of gateways, or copies of such directories.
        now: current time.
        requeue_missing: whether to return missing episodes to the queue as lost.
        on_progress: progress callback with the number of processed episodes and the total.
        shard_episodes: number of consecutive episode numbers that a shard of a states dataset covers.

    Raises:
        UsageError: a source is not a directory of a gateway.
        WorldError: a coordinator holds the dataset, its ledger is lost or damaged, or the disk cannot be written.
    """
    for source in sources:
        if not (source / EPISODES).is_dir():
            raise UsageError(f"{source} has no {EPISODES}/: give the --out of a gateway, or a copy of it")
    missing: list[Missing] = []
    with ExitStack() as stack:
        store = dataset.root if isinstance(dataset.root, ObjectPath) else None
        archive = stack.enter_context(open_archive(dataset.state_dir, store))
        _require_ledger(dataset)
        engine = open_writer(dataset.url)
        stack.callback(engine.dispose)
        with engine.connect() as connection:
            wanted = _wanted(connection)
        packing = partial(_pack, archive, engine, dataset.plan, shard_episodes)
        for done, one in enumerate(wanted, 1):
            if done > 1 and range_of(one.index, shard_episodes) != range_of(wanted[done - 2].index, shard_episodes):
                packing()  # all episodes of the previous range are processed
            why = _fetch(archive, one, sources)
            if why:
                missing.append(Missing(episode=episode_id(one.index), gateway=one.gateway, why=why))
            _settle(engine, one, why, now, requeue_missing=requeue_missing)
            on_progress(done, len(wanted))
        packing()
        with engine.connect() as connection:
            write_checkpoint(archive, connection, dataset.plan, dataset.catalog, now)
        write_split_tables(archive)
        return GatherReport(
            dataset=str(dataset.root),
            run=dataset.plan.run,
            gathered=len(wanted) - len(missing),
            missing=tuple(missing),
            requeued=requeue_missing and bool(missing),
            episodes=len(archive.present()),
            planned=dataset.plan.episodes,
        )


def _require_ledger(dataset: RepairInput) -> None:
    if dataset.foreign_ledger:
        raise WorldError(f"the ledger {dataset.foreign_ledger}; `factory repair {quoted(dataset.root)}` replaces it")
    require_sound(dataset.url)


def _wanted(connection: Connection) -> list[_Wanted]:
    away = gateways_by_episode(connection)
    rows = connection.execute(select(episodes.c.idx, episodes.c.sha256, episodes.c.size).order_by(episodes.c.idx))
    return [_Wanted(row.idx, away[row.idx], row.sha256, row.size) for row in rows if row.idx in away]


def _settle(engine: Engine, one: _Wanted, why: str, now: datetime, *, requeue_missing: bool) -> None:
    if not why:
        with engine.begin() as connection:
            record_at_core(connection, one.index)
    elif requeue_missing:
        with engine.begin() as connection:
            lose(connection, one.index, now, f"stored at gateway {one.gateway}: {why}")


def _pack(archive: Archive, engine: Engine, plan: Plan, size: int) -> None:
    # gateways do not pack, because only the ledger knows the ranges whose jobs can no longer change
    with engine.connect() as connection:
        pack_settled(archive, connection, plan=plan, is_over=not has_open_jobs(connection), size=size)


def _fetch(archive: Archive, one: _Wanted, sources: Sequence[Path]) -> str:
    """Copies an episode durably into the dataset; returns the reason if that fails, else an empty string."""
    place = archive.path_of(one.index)
    if place.exists():
        if digest_of(place) == one.sha256:
            return ""  # a previous call was interrupted before it updated the ledger
        archive.quarantine(place, f"its SHA-256 is not {one.sha256}, which the ledger has")
    reasons = []
    for source in sources:
        path = episode_place(source, one.index)
        if path.is_file():
            why = _copy(archive, one, path)
            if not why:
                return ""
            reasons.append(why)
    return "; ".join(reasons) or "found in none of the directories given"


def _copy(archive: Archive, one: _Wanted, path: FilePlace) -> str:
    # copies, because hard links are possible only within one file system
    with archive.stage(one.index) as staged:
        try:
            with path.open("rb") as file:
                while staged.size <= one.size and (block := file.read(_COPY_BYTES)):
                    staged.write(block)
        except OSError as error:  # the source cannot be read; the archive raises WorldError
            return f"{path} cannot be read: {error.strerror}"
        if staged.sha256 != one.sha256:
            return f"{path} has SHA-256 {staged.sha256}, but {one.sha256} in the ledger"
        archive.publish(staged, one.index)
    return ""
