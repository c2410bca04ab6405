"""Measures the CPU time of checkpoints of large ledgers.

Writes three checkpoints for each size: the first one, one after 50 new episodes, and one without any change.

python -m tests.benchmarks.tables [ROWS ...]
"""

from __future__ import annotations

import sys
import tempfile
import time
from collections.abc import Iterator
from datetime import UTC, datetime
from pathlib import Path

from sqlalchemy import create_engine, insert

from coordinator.archive.opening import open_archive
from coordinator.ledger.database.engine import sqlite_url
from coordinator.ledger.states import Event, JobState
from coordinator.ledger.tables import METADATA, episodes, events, jobs
from coordinator.tables.checkpoint import Checkpoints
from factory.support.terminal import print_table
from schemas.dataset.rows import summary_of
from schemas.episode_spec import EpisodeSpec
from tests.builders.bundle import parts_for
from tests.builders.ledger import room_catalog, room_plan

_NOW = datetime(2026, 1, 2, tzinfo=UTC)
_SPEC = dict(EpisodeSpec.of(parts_for().meta.job))
_NEW = 50
"""Number of episodes that a busy run archives between two checkpoints."""


def main(sizes: list[int]) -> None:
    """Prints the CPU seconds of each checkpoint."""
    rows = [(size, *_measure(size)) for size in sizes or [10_000, 40_000, 200_000]]
    print_table("tables written from the ledger, CPU seconds", ("rows", "first", f"{_NEW} more", "unchanged"), rows)


def _measure(size: int) -> tuple[float, float, float]:
    plan, catalog = room_plan(size + _NEW), room_catalog()
    with tempfile.TemporaryDirectory() as folder, open_archive(Path(folder)) as archive:
        engine = create_engine(sqlite_url(Path(folder) / "ledger.db"))  # does not enforce foreign keys
        took = []
        checkpoints = Checkpoints(archive, plan, catalog)
        with engine.begin() as connection:
            METADATA.create_all(connection)
            connection.execute(insert(jobs), [_job(index) for index in range(1, size + _NEW + 1)])
        for first, last in ((1, size), (size + 1, size + _NEW), (0, -1)):
            with engine.begin() as connection:
                if last > 0:
                    connection.execute(insert(episodes), _rows(first, last))
                    connection.execute(insert(events), [_event(index) for index in range(first, last + 1)])
            with engine.connect() as connection:
                started = time.process_time()
                checkpoints.write(connection, _NOW)
                took.append(round(time.process_time() - started, 3))
        engine.dispose()
    return took[0], took[1], took[2]


def _job(index: int) -> dict[str, object]:
    spec = dict(_SPEC, idx=index, draw=0)
    return {**spec, "state": JobState.ARCHIVED, "sha256": f"{index:064x}", "size": 1000}


def _event(index: int) -> dict[str, object]:
    return {
        "at": float(index),
        "job_id": index,
        "event": Event.ARCHIVED,
        "state": JobState.ARCHIVED,
        "attempt": 1,
        "fence": 1,
    }


def _rows(first: int, last: int) -> list[dict[str, object]]:
    return list(_generate(first, last))


def _generate(first: int, last: int) -> Iterator[dict[str, object]]:
    summary = summary_of(parts_for().meta, "0" * 64, 1000)
    text = summary.model_dump_json().replace('"index":1,', '"index":%d,').replace("ep_000001", "ep_%06d")
    form = text.replace("0" * 64, "%064x", 1)
    for index in range(first, last + 1):
        yield {
            "idx": index,
            "job_id": index,
            "attempt": 1,
            "sha256": f"{index:064x}",
            "size": summary.file_bytes,
            "content_digest": summary.content_digest,
            "summary": _filled(form, index),
            "archived_at": float(index),
        }


def _filled(form: str, index: int) -> str:
    for mark, value in (("%d", str(index)), ("%06d", f"{index:06d}"), ("%064x", f"{index:064x}")):
        form = form.replace(mark, value)
    return form


if __name__ == "__main__":
    main([int(word) for word in sys.argv[1:]])
