"""Quarantines or cancels the unfinished jobs of a finished shard in the ledger of a joined run.

The tables of a shard list its failed attempts, but not the states of its jobs. If the shard is finished, a job without
an episode was quarantined or cancelled there. States of jobs in the tables would change the format of datasets.
"""

from __future__ import annotations

import secrets
from collections.abc import Collection
from datetime import datetime

from sqlalchemy import bindparam, func, select
from sqlalchemy.engine import Connection

from coordinator.ledger.states import Event, JobState
from coordinator.ledger.tables import attempts, jobs
from coordinator.ledger.transitions import FREED, JobRow, Transition
from schemas.terms import FailReason

_BY = "gather"
_WORKER_FAILURES = tuple(reason.value for reason in FailReason if reason.is_worker_failure)
_AS_READ = (jobs.c.id == bindparam("of_job"), jobs.c.fence == bindparam("of_fence"))
_TAKE = Transition(
    Event.CLAIMED, *_AS_READ, fence=jobs.c.fence + 1, token=bindparam("of_token"), sid=_BY, lease_until=None
)
_QUARANTINE = Transition(Event.QUARANTINED, *_AS_READ, **FREED, reason=bindparam("why"), crashes=bindparam("failures"))
_CANCEL = Transition(Event.CANCELLED, *_AS_READ, reason=bindparam("why"))
_PENDING = (
    select(jobs.c.id, jobs.c.fence, jobs.c.idx)
    .where(jobs.c.state == JobState.PENDING, jobs.c.idx.between(bindparam("first"), bindparam("last")))
    .order_by(jobs.c.idx)
)


def end_unfinished_jobs(
    connection: Connection, numbers: range, kept: Collection[int], shard: str, now: datetime
) -> int:
    """Quarantines or cancels the pending jobs of a finished shard; returns their number.

    Args:
        connection: connection with an open transaction, after the failed attempts of the shard were recorded.
        numbers: episode numbers of the shard.
        kept: numbers of the shard's episodes; jobs of damaged or missing files stay pending.
        shard: number and count of the shard.
        now: time of the call.
    """
    pending = connection.execute(_PENDING, {"first": numbers[0], "last": numbers[-1]}).all()
    ended = [row for row in pending if row.idx not in kept]
    for row in ended:
        _end(connection, row, shard, now)
    return len(ended)


def _end(connection: Connection, row: JobRow, shard: str, now: datetime) -> None:
    which = (attempts.c.job_id == row.id, attempts.c.outcome.in_(_WORKER_FAILURES))
    failures = connection.execute(select(func.count()).where(*which)).scalar_one()
    last = connection.execute(select(attempts).where(*which).order_by(attempts.c.id.desc()).limit(1)).first()
    detail = f"by factory gather, as in shard {shard}"
    if last is None:
        why = f"cancelled in shard {shard}"
        _CANCEL.make(connection, {"of_job": row.id, "of_fence": row.fence, "why": why}, now, by=_BY, detail=detail)
        return
    why = f"quarantined in shard {shard} after {failures} worker failures; the last was {last.outcome}: {last.detail}"
    token = {"of_token": secrets.token_hex(16)}
    taken = _TAKE.make(connection, {"of_job": row.id, "of_fence": row.fence} | token, now, by=_BY, detail=detail)
    assert taken is not None, "the ledger was changed by another writer"
    ending = {"of_job": taken.id, "of_fence": taken.fence, "why": why, "failures": failures}
    _QUARANTINE.make(connection, ending, now, by=_BY, detail=detail)
