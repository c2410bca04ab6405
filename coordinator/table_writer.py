"""Packs settled episodes and writes the dataset's tables, during a run and at its end. Does not change jobs."""

from __future__ import annotations

import threading
from collections.abc import Sequence

import structlog

from coordinator.context import RunContext
from coordinator.ledger import claims
from coordinator.ledger.run_ledger import RESTART_REMEDY
from coordinator.packing import pack_settled
from coordinator.tables.checkpoint import Checkpoints, has_changes, last_event
from coordinator.tables.split_tables import write_split_tables
from schemas.dataset.meta import GateOutcome
from schemas.errors import WorldError
from schemas.storage.dataset_files import META_FILE

_THUMBNAILS_S = 2.0
"""Time limit of thumbnails when an unfinished run stops, seconds."""

log = structlog.get_logger(__name__)


class TableWriter:
    """Keeps the tables of one run up to date; an evaluation has none.

    Args:
        run: shared parts of the coordinator.
        gate: results of the gate before a new run.
    """

    def __init__(self, run: RunContext, gate: Sequence[GateOutcome]) -> None:
        self._run = run
        terms = run.terms
        self._checkpoints = (
            Checkpoints(run.archive, terms.plan, terms.catalog, gate) if terms.evaluation is None else None
        )
        with run.ledger.reading() as connection:
            self._up_to = last_event(connection)
        self._are_readable = (run.archive.root / META_FILE).is_file()
        self._is_first_due = False
        self._changed = threading.Event()
        if run.are_tables_owed:
            self._changed.set()

    def note_change(self) -> None:
        """Records an archived or lost episode, so the next `write` writes the tables."""
        self._changed.set()
        self._is_first_due = not self._are_readable

    def write_first(self) -> None:
        """Writes the tables of a new run once it has an episode, so the dataset can be read during the run."""
        if self._is_first_due:
            self.write()

    def write(self) -> None:
        """Packs settled episodes and writes the tables if an episode or attempt was recorded since the last write."""
        run = self._run
        if self._checkpoints is None or not self._are_outdated():
            return
        self._changed.clear()
        try:
            with run.ledger.reading() as connection:
                up_to = last_event(connection)
                is_over = not claims.has_open_jobs(connection)
                pack_settled(
                    run.archive, connection, plan=run.terms.plan, is_over=is_over, size=run.settings.shard_episodes
                )
                # the first and the last write read all rows from the ledger: another process may have changed the files
                self._checkpoints.write(connection, run.clock(), rewrite=is_over)
            self._up_to, self._are_readable, self._is_first_due = up_to, True, False
        except Exception:
            self._changed.set()  # the tables still have to be written
            raise

    def _are_outdated(self) -> bool:
        """Returns whether the tables are outdated.

        The events of the ledger are read too, because `note_change` is not called after a failed attempt.
        """
        if self._changed.is_set():
            return True
        try:
            with self._run.ledger.reading() as connection:
                return has_changes(connection, self._up_to)
        except WorldError:  # the ledger is lost; the run stops and reports this
            return False

    def write_splits(self) -> None:
        """Writes the split tables; called once, at the end, because it reads a frame of each new episode.

        The time for thumbnails is limited if the run is not finished.
        """
        if self._checkpoints is None or self._changed.is_set():
            return  # `metadata.parquet`, the source of the split tables, is outdated
        try:
            limit_s = None if self._run.ledger.is_finished() else _THUMBNAILS_S
        except WorldError as error:
            log.warning("split_tables_not_written", error=str(error), remedy=RESTART_REMEDY)
            return
        write_split_tables(self._run.archive, limit_s)
