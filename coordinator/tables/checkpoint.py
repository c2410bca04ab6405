"""Writes the dataset's tables, archived episodes and failed attempts, from the ledger. Does not change the ledger."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from datetime import UTC, datetime
from typing import Any

from sqlalchemy import Row, func, select
from sqlalchemy.engine import Connection

from coordinator.archive.contract import Archive
from coordinator.expansion.catalog import Catalog
from coordinator.expansion.instances import Sides, shared_categories
from coordinator.expansion.scene_cells import scene_cells
from coordinator.ledger.builds import refused_seeds
from coordinator.ledger.outcomes import SUCCESS
from coordinator.ledger.reading.records import LedgerEpisodes
from coordinator.ledger.states import Event
from coordinator.ledger.tables import IS_EPISODE, attempts, episodes, events, jobs
from coordinator.tables.write import DatasetTables, TableChanges, TableContent
from schemas.dataset.meta import DatasetMeta, GateOutcome, read_dataset_meta
from schemas.dataset.rows import FailedAttempt
from schemas.episode_spec import columns_of
from schemas.errors import ArchiveCorrupt, WorldError
from schemas.job import episode_id
from schemas.plan import Plan

_YIELD_ROWS = 1000
_OF_LEASES = (Event.CLAIMED, Event.ANNOUNCED)
_OF_EPISODES = frozenset({Event.ARCHIVED, Event.ADOPTED, Event.LOST})
_WITHOUT_FAILURE = frozenset({Event.ARCHIVED, Event.ADOPTED})
_FAILURES = (
    select(attempts, jobs.c.scene, jobs.c.tier, jobs.c.split, jobs.c.category, jobs.c.target_id)
    .join(jobs, jobs.c.id == attempts.c.job_id)
    .where(attempts.c.outcome != SUCCESS, IS_EPISODE)
    .order_by(attempts.c.idx, attempts.c.attempt, attempts.c.id)
)


class Checkpoints:
    """Writer of the tables of one run; a checkpoint reads the rows that have changed since the last one.

    Args:
        archive: archive of the dataset, held exclusively.
        plan: plan of the run.
        catalog: compiled scenes of the plan; layouts are added when they are built.
        gate: results of the gate; empty keeps the results in the existing metadata.
    """

    def __init__(self, archive: Archive, plan: Plan, catalog: Catalog, gate: Sequence[GateOutcome] = ()) -> None:
        self._archive, self._plan, self._gate, self._catalog = archive, plan, gate, catalog
        self._sides: dict[str, Sides] = {}
        self._shared: dict[str, tuple[str, ...]] | None = {} if plan.disjoint_instances else None
        self._tables = DatasetTables()
        self._last_event: int | None = None

    def write(self, connection: Connection, now: datetime, *, rewrite: bool = False) -> DatasetMeta:
        """Writes the tables and replaces each file as a whole.

        Args:
            connection: connection for reading.
            now: the time of writing, UTC.
            rewrite: whether to read every row from the ledger, as the first call does.

        Raises:
            WorldError: the disk is full or unavailable; each file is complete, either the previous or the new version.
        """
        last = last_event(connection)
        changes = None if rewrite or self._last_event is None else _changes(connection, self._last_event)
        content = TableContent(
            plan=self._plan,
            scenes=self._present_scenes(),
            episodes=LedgerEpisodes(connection),
            failures=LedgerFailures(connection),
            sides=self._sides,
            shared=self._shared,
            gate=self._gate,
            refused_seeds=refused_seeds(connection),
        )
        meta = self._tables.write(self._archive, content, now, changes)
        self._last_event = last
        return meta

    def _present_scenes(self) -> dict[str, str]:
        """Returns the package digest of each scene in the catalog, in the order of the plan.

        Computes the sides of the instances in scenes that are new in the catalog.
        """
        parts = [part for part in self._plan.parts if part.name in self._catalog]
        for part in parts:
            entry = self._catalog[part.name]
            if self._shared is not None and part.name not in self._sides:
                self._sides[part.name] = sides = scene_cells(self._plan, part, entry).sides
                if sides:
                    self._shared[part.name] = shared_categories(sides, entry)
        return {part.name: self._catalog[part.name].sha256 for part in parts}


def write_checkpoint(
    archive: Archive,
    connection: Connection,
    plan: Plan,
    catalog: Catalog,
    now: datetime,
    gate: Sequence[GateOutcome] = (),
) -> DatasetMeta:
    """Writes the tables from the ledger once; for arguments and errors see `Checkpoints`."""
    return Checkpoints(archive, plan, catalog, gate).write(connection, now)


def last_event(connection: Connection) -> int:
    """Returns the id of the last event; 0 if there is none."""
    return int(connection.execute(select(func.coalesce(func.max(events.c.id), 0))).scalar_one())


def has_changes(connection: Connection, since: int) -> bool:
    """Returns whether an event after the given one changed an episode or an attempt, not only a lease."""
    later = select(events.c.id).where(events.c.id > since, events.c.event.not_in(_OF_LEASES)).limit(1)
    return connection.execute(later).first() is not None


def _changes(connection: Connection, since: int) -> TableChanges:
    """Returns the episodes whose rows have changed since an event; the ledger records an event with each change."""
    query = (
        select(events.c.event, jobs.c.idx)
        .join(jobs, jobs.c.id == events.c.job_id)
        .where(events.c.id > since, events.c.event.not_in(_OF_LEASES), IS_EPISODE)
    )
    archived: set[int] = set()
    failed: set[int] = set()
    for event, index in connection.execute(query.execution_options(yield_per=_YIELD_ROWS)):
        if event in _OF_EPISODES:
            archived.add(index)
        if event not in _WITHOUT_FAILURE:
            failed.add(index)
    return TableChanges(archived, failed)


def is_checkpoint_due(archive: Archive, connection: Connection) -> bool:
    """Returns whether the tables lag behind the ledger, e.g. because the last coordinator was killed."""
    archived = connection.execute(select(func.count()).select_from(episodes)).scalar_one()
    counts = (archived, count_failures(connection))
    try:
        meta = read_dataset_meta(archive.root)
    except ArchiveCorrupt:
        return True
    except WorldError:
        return any(counts)
    return (meta.episodes, meta.failed_attempts) != counts


def count_failures(connection: Connection) -> int:
    """Returns the number of attempts that produced no episode."""
    of_jobs = attempts.join(jobs, jobs.c.id == attempts.c.job_id)
    failed = select(func.count()).select_from(of_jobs).where(attempts.c.outcome != SUCCESS, IS_EPISODE)
    return int(connection.execute(failed).scalar_one())


class LedgerFailures:
    """Source of failed attempts for the table writer.

    Args:
        connection: connection for reading.
    """

    def __init__(self, connection: Connection) -> None:
        self._connection = connection

    def rows(self, first: int, last: int) -> Iterator[FailedAttempt]:
        """Yields the attempts that produced no episode, for a range of episode numbers; order as in `read_failures`."""
        return map(_failure_of, self._connection.execute(_FAILURES.where(jobs.c.idx.between(first, last))))


def read_failures(connection: Connection) -> Iterator[FailedAttempt]:
    """Yields the attempts that produced no episode, ordered by episode, attempt and time."""
    return map(_failure_of, connection.execute(_FAILURES.execution_options(yield_per=_YIELD_ROWS)))


def _failure_of(row: Row[Any]) -> FailedAttempt:
    return FailedAttempt(
        episode_id=episode_id(row.idx),
        draw=row.draw,
        attempt=row.attempt,
        **columns_of(row, FailedAttempt),
        reason=row.outcome,
        detail=row.detail,
        steps=row.steps,
        seconds=row.seconds,
        worker=row.sid,
        at=datetime.fromtimestamp(row.at, UTC),
    )
