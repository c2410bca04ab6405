"""Writes the dataset's tables, archived episodes and failed attempts, from the ledger. Does not change the ledger."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from datetime import UTC, datetime

from sqlalchemy import func, select
from sqlalchemy.engine import Connection

from coordinator.archive.contract import Archive
from coordinator.expansion.catalog import Catalog
from coordinator.expansion.instances import shared_categories
from coordinator.expansion.scene_cells import all_sides
from coordinator.ledger.outcomes import SUCCESS
from coordinator.ledger.reading.records import LedgerEpisodes
from coordinator.ledger.tables import attempts, episodes, jobs
from coordinator.tables.write import write_tables
from schemas.dataset import FailedAttempt
from schemas.dataset_meta import DatasetMeta, GateOutcome, read_dataset_meta
from schemas.episode_spec import columns_of
from schemas.errors import ArchiveCorrupt, WorldError
from schemas.job import episode_id
from schemas.plan import Plan

_YIELD_ROWS = 1000


def write_checkpoint(
    archive: Archive,
    connection: Connection,
    plan: Plan,
    catalog: Catalog,
    now: datetime,
    gate: Sequence[GateOutcome] = (),
    *,
    anew: bool = True,
) -> DatasetMeta:
    """Writes the tables and replaces each file as a whole; for the arguments see `write_tables`.

    Raises:
        WorldError: the disk is full or unavailable; the tables are unchanged.
    """
    scenes = {name: entry.sha256 for name, entry in catalog.items()}
    sides = all_sides(plan, catalog)
    shared = {name: shared_categories(found, catalog[name]) for name, found in sides.items()}
    return write_tables(
        archive,
        plan,
        scenes,
        LedgerEpisodes(connection),
        read_failures(connection),
        now,
        sides,
        shared if plan.disjoint_instances else None,
        gate,
        anew=anew,
    )


def is_checkpoint_owed(archive: Archive, connection: Connection) -> bool:
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
    """Returns the number of attempts without an episode."""
    failed = select(func.count()).select_from(attempts).where(attempts.c.outcome != SUCCESS)
    return int(connection.execute(failed).scalar_one())


def read_failures(connection: Connection) -> Iterator[FailedAttempt]:
    """Yields the attempts without an episode, ordered by episode, attempt and time."""
    query = (
        select(attempts, jobs.c.scene, jobs.c.tier, jobs.c.split, jobs.c.category, jobs.c.target_id)
        .join(jobs, jobs.c.id == attempts.c.job_id)
        .where(attempts.c.outcome != SUCCESS)
        .order_by(attempts.c.idx, attempts.c.attempt, attempts.c.id)
    )
    for row in connection.execution_options(yield_per=_YIELD_ROWS).execute(query):
        yield FailedAttempt(
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
