"""Restores records of a lost or outdated ledger from the dataset's tables. Writes to the ledger only."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from datetime import datetime

from sqlalchemy import Engine

from coordinator.expansion.catalog import Catalog
from coordinator.ledger.repair import record_failures
from coordinator.recovery.stray_files import PlannedDraws
from coordinator.tables.checkpoint import count_failures, read_failures
from coordinator.tables.table_reader import read_column, read_failed_attempts
from schemas.dataset.meta import read_dataset_meta
from schemas.dataset.rows import EpisodeSummary, FailedAttempt
from schemas.episode_spec import columns_of
from schemas.errors import WorldError
from schemas.plan import Plan
from schemas.storage.dataset_files import ATTEMPTS_FILE, METADATA_FILE
from schemas.storage.place import Place


def validated_files(root: Place, plan: Plan) -> Mapping[int, str]:
    """Returns the SHA-256 of the validated file by episode number, from `metadata.parquet`.

    Args:
        root: root of the dataset.
        plan: plan of the run; rows of other plans are ignored.
    """
    columns = [read_column(root / METADATA_FILE, name) for name in ("index", "file_sha256", "plan_digest")]
    if any(isinstance(column, str) for column in columns):
        return {}
    return {
        int(index): sha256
        for index, sha256, digest in zip(*columns, strict=True)
        if digest == plan.digest and index.isdecimal()
    }


def restore_failures(
    engine: Engine,
    root: Place,
    plan: Plan,
    catalog: Catalog,
    now: datetime,
    whole: Mapping[int, EpisodeSummary],
) -> None:
    """Records the failed attempts that `attempts.parquet` lists and the ledger lacks.

    Does nothing if the table is not ahead of the ledger, which is the normal case: the table is written from the
    ledger.

    Args:
        engine: engine of the ledger writer.
        root: root of the dataset.
        plan: plan of the run.
        catalog: compiled scenes of the plan.
        now: time of the repair.
        whole: rows of the files to adopt, by episode number.
    """
    with engine.begin() as connection:
        if not whole and _failed_attempts(root) <= count_failures(connection):
            return
        known = list(read_failures(connection))
        told = list(failures_of(root, PlannedDraws(plan, catalog, connection)))
        ends = {index: (summary.draw, summary.attempt) for index, summary in whole.items()}
        record_failures(connection, plan, catalog, told, known, now, ends)


def _failed_attempts(root: Place) -> int:
    try:
        return read_dataset_meta(root).failed_attempts
    except WorldError:
        return 0


def failures_of(root: Place, draws: PlannedDraws) -> Iterator[FailedAttempt]:
    """Yields the rows of `attempts.parquet` that match the plan's draws; a table of another run must not change jobs.

    Args:
        root: root of the dataset.
        draws: draws of the plan.
    """
    for one in read_failed_attempts(root / ATTEMPTS_FILE):
        number = one.episode_id.removeprefix("ep_")
        planned = draws.planned(int(number), one.draw) if number.isdecimal() else None
        if planned is None:
            continue
        wanted = columns_of(planned.episode, FailedAttempt)
        if all(getattr(one, column) == value for column, value in wanted.items()):
            yield one
