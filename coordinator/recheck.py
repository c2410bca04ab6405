"""Validates the unchecked episodes of barred hosts completely; invalid ones are quarantined and generated again.

The ledger lists the episodes, so a restarted coordinator continues. Runs no thread.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

import structlog
from sqlalchemy.engine import Connection

from coordinator.context import RunContext
from coordinator.expansion.draw import to_job
from coordinator.ledger.archived import note_checked, suspects
from coordinator.ledger.opening import planned_of
from coordinator.ledger.outcomes import lose
from coordinator.ledger.repair import current_job
from schemas.errors import InvalidBundle
from schemas.exchangeable import candidates_of
from schemas.job import Job, episode_id
from schemas.storage.place import local_copy

_AT_ONCE = 20
"""Number of episodes per call."""

log = structlog.get_logger(__name__)


class Rechecks:
    """Complete validation of episodes that the coordinator accepted because their worker had validated them.

    Args:
        run: shared parts of the coordinator.
        on_change: callback after an episode was removed.
    """

    def __init__(self, run: RunContext, on_change: Callable[[], None]) -> None:
        self._run, self._on_change = run, on_change

    def check_some(self) -> None:
        """Validates some unchecked episodes of barred hosts.

        Raises:
            TransientError: the episodes cannot be validated now; the next call repeats them.
            WorldError: an episode cannot be moved to the quarantine folder.
        """
        with self._run.ledger.reading() as connection:
            suspected = [(index, self._job_of(connection, index)) for index in suspects(connection, _AT_ONCE)]
        for index, job in suspected:
            refusal = self._refusal_of(index, job)
            if refusal:
                self._remove(index, refusal)
            else:
                self._run.ledger.writer.call(partial(note_checked, index=index))

    def _job_of(self, connection: Connection, index: int) -> Job:
        terms, row = self._run.terms, current_job(connection, index)
        assert row is not None
        return to_job(terms.plan, terms.catalog, planned_of(row), row.attempt)

    def _refusal_of(self, index: int, job: Job) -> str:
        """Returns the reason why an episode is invalid; empty if it is valid."""
        candidates = candidates_of(job, self._run.terms.catalog[job.scene].info)
        try:
            with local_copy(self._run.archive.path_of(index)) as file:
                self._run.checker.check(file, job, candidates)
        except InvalidBundle as error:
            return str(error)
        return ""

    def _remove(self, index: int, refusal: str) -> None:
        """Quarantines an episode and queues its job again; the next start completes an interrupted move."""
        why = f"its worker announced it as valid, but it is invalid: {refusal}"
        self._run.archive.quarantine(self._run.archive.path_of(index), why)
        now = self._run.clock()
        self._run.ledger.writer.call(lambda connection: lose(connection, index, now, why))
        self._on_change()
        log.warning(
            "unchecked_episode_invalid", episode=episode_id(index), reason=refusal, remedy="it is generated again"
        )
