"""Records how attempts end: announced, archived, failed in simulation, crashed, released or lost.

Each function is idempotent and fenced by the lease, which belongs to a host: a lease that is not in force changes
nothing.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from datetime import datetime
from typing import Any, NamedTuple

from sqlalchemy import bindparam, delete, insert, select, update
from sqlalchemy.engine import Connection

from coordinator.expansion.draw import PlannedJob
from coordinator.ledger import hosts
from coordinator.ledger.builds import budget_of_builds, insert_next_seed
from coordinator.ledger.claims import HELD_STATES
from coordinator.ledger.database.prepared import PreparedStatement
from coordinator.ledger.opening import insert_planned, planned_digest, planned_of, write_info
from coordinator.ledger.states import Event, JobState
from coordinator.ledger.tables import (
    BUILD,
    PLANNED,
    attempts,
    episodes,
    gateway_episodes,
    jobs,
    unchecked_episodes,
    workers,
)
from coordinator.ledger.transitions import FREED, JOB, UNDER_LEASE, JobRow, Transition, lease_parameters, record_attempt
from schemas.dataset.rows import BundleReceipt
from schemas.plan import Budget
from schemas.protocol.keys import host_of
from schemas.protocol.messages import Done, Fail, Lease

Successor = Callable[[PlannedJob], PlannedJob]

SUCCESS = "success"
"""Outcome of the attempt that produced the episode."""
_LOST = "lost"
_CRASH_PAUSE_S = 1.0
"""Pause after the first crash of a job, seconds; it doubles with each crash."""
_CRASHES_ALONE = hosts.STRIKES + 2
"""Crashes after which a job is quarantined if only one host has tried it. A host that fails every job is barred before
any job has so many crashes."""


_UNDER_LEASE = PreparedStatement(select(*JOB).where(*UNDER_LEASE))
_PAUSED: dict[str, Any] = {
    "attempt": bindparam("next_attempt"),
    "not_before": bindparam("until"),
    "reason": bindparam("why"),
}
_ANNOUNCE = Transition(
    Event.ANNOUNCED,
    *UNDER_LEASE,
    sha256=bindparam("announced"),
    size=bindparam("bytes"),
    sid=bindparam("by"),
    lease_until=bindparam("until"),
)
_IS_ANNOUNCED = (jobs.c.idx == bindparam("index"), jobs.c.sha256 == bindparam("announced"))
_ARCHIVE = Transition(Event.ARCHIVED, *UNDER_LEASE, *_IS_ANNOUNCED, lease_until=None, losses=0)
_END_BUILD = Transition(
    Event.ARCHIVED, *UNDER_LEASE, _IS_ANNOUNCED[1], lease_until=None, losses=0, sha256=bindparam("package")
)
_ADOPT = Transition(Event.ADOPTED, jobs.c.id == bindparam("of_job"), *_IS_ANNOUNCED, lease_until=None, losses=0)
_LOSE = Transition(Event.LOST, jobs.c.idx == bindparam("index"), jobs.c.superseded.is_(False), **FREED, not_before=0.0)
_AFTER_TASK_FAILURE: dict[str, Any] = {
    **FREED,
    **_PAUSED,
    "misses": jobs.c.misses + 1,
    "losses": 0,
    "superseded": bindparam("has_successor"),
}
_TASK_FAILED = Transition(Event.TASK_FAILED, *UNDER_LEASE, **_AFTER_TASK_FAILURE)
_EXHAUST = Transition(Event.EXHAUSTED, *UNDER_LEASE, **_AFTER_TASK_FAILURE)
_AFTER_WORKER_FAILURE: dict[str, Any] = {**FREED, **_PAUSED, "crashes": jobs.c.crashes + 1}
_WORKER_FAILED = Transition(Event.WORKER_FAILED, *UNDER_LEASE, **_AFTER_WORKER_FAILURE)
_QUARANTINE = Transition(Event.QUARANTINED, *UNDER_LEASE, **_AFTER_WORKER_FAILURE)
_RELEASE = Transition(Event.RELEASED, *UNDER_LEASE, **FREED, not_before=bindparam("until"))
_INSERT_EPISODE = PreparedStatement(insert(episodes))
_COUNT_ARCHIVED = PreparedStatement(
    update(workers).where(workers.c.sid == bindparam("by")).values(archived=workers.c.archived + 1)
)
_STORED_BY_COORDINATOR = PreparedStatement(
    select(episodes.c.idx)
    .outerjoin(gateway_episodes, gateway_episodes.c.idx == episodes.c.idx)
    .where(gateway_episodes.c.idx.is_(None), episodes.c.idx == bindparam("index"))
)


class Announced(NamedTuple):
    """Result of an announcement."""

    accepted: bool
    """Whether the lease belongs to the worker and is in force or fulfilled."""
    waiting: JobRow | None
    """Row of the job if its bundle is not pulled yet, else `None`."""


def announce(connection: Connection, done: Done, now: datetime, ttl_s: float) -> Announced:
    """Records that a bundle can be pulled. The call is idempotent."""
    lease = lease_parameters(done.lease)
    known = _UNDER_LEASE.first(connection, lease)
    if known is None or known.state not in (*HELD_STATES, JobState.ARCHIVED) or not _is_of_same_host(known, done.sid):
        return Announced(False, None)
    if known.state == JobState.ARCHIVED:
        return Announced(True, None)
    if (known.state, known.sha256, known.size, known.sid) == (JobState.SUBMITTED, done.sha256, done.size, done.sid):
        return Announced(True, known)
    bundle = {"announced": done.sha256, "bytes": done.size, "by": done.sid, "until": now.timestamp() + ttl_s}
    row = _ANNOUNCE.make(connection, lease | bundle, now, by=done.sid)
    return Announced(row is not None, row)


def archive(connection: Connection, lease: Lease, summary: BundleReceipt, now: datetime) -> bool:
    """Records a published episode if the lease is in force; returns whether it was recorded."""
    return _record_episode(connection, _ARCHIVE, job=lease_parameters(lease), summary=summary, now=now)


def record_package(
    connection: Connection, lease: Lease, announced: str, package: str, planned: Sequence[PlannedJob], now: datetime
) -> bool:
    """Records the package of a layout and inserts the episodes of the layout, if the lease of the build is in force.

    Args:
        connection: connection with an open transaction.
        lease: lease of the build.
        announced: digest of the announced file.
        package: digest of the stored package.
        planned: first draws of the episodes of the layout.
        now: time of the record.
    """
    row = _END_BUILD.make(connection, {**lease_parameters(lease), "announced": announced, "package": package}, now)
    if row is None:
        return False
    insert_planned(connection, planned, now)
    span = range(planned[0].index, planned[-1].index + 1)
    write_info(connection, {f"{PLANNED}:{row.idx}": planned_digest(connection, span)})
    hosts.reduce_strikes(connection, row.sid)
    return True


def adopt(connection: Connection, job_id: int, summary: BundleReceipt, now: datetime) -> bool:
    """Records an episode that was published before a crash of the coordinator; its digest must be the announced one."""
    return _record_episode(connection, _ADOPT, job={"of_job": job_id}, summary=summary, now=now)


def fail(
    connection: Connection,
    report: Fail,
    now: datetime,
    budget: Budget,
    successor: Successor,
    *,
    blames_hosts: bool = True,
) -> bool:
    """Records a failed attempt: the next attempt or draw follows, or the job is quarantined or returned to the queue.

    Args:
        connection: connection with an open transaction.
        report: report with the reason and the lease.
        now: time of the report.
        budget: limits of attempts, draws and crashes.
        successor: function that returns the next draw of the same cell.
        blames_hosts: whether a worker failure is attributed to the host first.

    Returns:
        Whether the report was accepted, now or earlier.
    """
    row = _UNDER_LEASE.first(connection, lease_parameters(report.lease))
    if row is None or row.state not in HELD_STATES:
        return _was_reported(connection, report)
    if not _is_of_same_host(row, report.sid):
        return False
    if report.reason.is_task_failure:
        limits = budget_of_builds(budget) if row.tier == BUILD else budget
        return _record_task_failure(connection, row, report=report, now=now, budget=limits, successor=successor)
    if report.reason.is_worker_failure:
        return _record_worker_failure(connection, row, report=report, now=now, budget=budget, blames_hosts=blames_hosts)
    return _release(connection, row, report, now)


def lose(connection: Connection, index: int, now: datetime, detail: str) -> bool:
    """Requeues an archived episode whose file is missing or invalid; its attempt is repeated with the same number."""
    if _LOSE.make(connection, {"index": index}, now, detail=detail) is None:
        return False
    succeeded = (attempts.c.idx == index, attempts.c.outcome == SUCCESS)
    connection.execute(update(attempts).where(*succeeded).values(outcome=_LOST, settles=False, detail=detail))
    connection.execute(delete(episodes).where(episodes.c.idx == index))
    for table in (gateway_episodes, unchecked_episodes):
        connection.execute(delete(table).where(table.c.idx == index))
    return True


def is_recorded(connection: Connection, index: int) -> bool:
    """Returns whether the ledger records the episode in the coordinator's directory; its file must then be kept."""
    return _STORED_BY_COORDINATOR.first(connection, {"index": index}) is not None


def _record_episode(
    connection: Connection, how: Transition, job: Mapping[str, Any], summary: BundleReceipt, now: datetime
) -> bool:
    """Changes the job to archived and records attempt and episode; returns whether the transition was possible."""
    announced = {"index": summary.index, "announced": summary.file_sha256}
    row = how.make(connection, {**job, **announced}, now)
    if row is None:
        return False
    record_attempt(connection, row, SUCCESS, now, settles=True, steps=summary.num_steps)
    _INSERT_EPISODE.count(
        connection,
        {
            "idx": row.idx,
            "job_id": row.id,
            "attempt": row.attempt,
            "sha256": summary.file_sha256,
            "size": summary.file_bytes,
            "content_digest": summary.content_digest,
            "summary": summary.model_dump_json(),
            "archived_at": now.timestamp(),
        },
    )
    _COUNT_ARCHIVED.count(connection, {"by": row.sid})
    hosts.reduce_strikes(connection, row.sid)
    return True


def _is_of_same_host(row: JobRow, sid: str) -> bool:
    """Returns whether a session belongs to the host that holds the lease."""
    return host_of(row.sid) == host_of(sid)


def _was_reported(connection: Connection, report: Fail) -> bool:
    same = (attempts.c.job_id == report.lease.job_id, attempts.c.fence == report.lease.fence)
    outcome = connection.execute(select(attempts.c.outcome).where(*same)).scalar()
    return outcome == report.reason


def _record_task_failure(
    connection: Connection, row: JobRow, report: Fail, now: datetime, budget: Budget, successor: Successor
) -> bool:
    """Records a task failure: the next attempt at this draw follows, else the next draw, else the episode fails."""
    is_last = row.misses + 1 >= budget.attempts_per_draw
    has_successor = is_last and row.draw + 1 < budget.draws
    values = {
        "next_attempt": row.attempt + 1,
        "until": now.timestamp(),
        "why": f"{report.reason}: {report.detail}" if is_last else "",
        "has_successor": has_successor,
    }
    if not _settle(connection, _EXHAUST if is_last else _TASK_FAILED, row, report, now, values, settles=True):
        return False
    if has_successor and row.tier == BUILD:
        insert_next_seed(connection, row, now, row.attempt + 1)
    elif has_successor:
        # a new row, because the row of the failed draw keeps its target and the reasons of its attempts
        insert_planned(connection, [successor(planned_of(row))], now, attempt=row.attempt + 1)
    return True


def _record_worker_failure(
    connection: Connection, row: JobRow, report: Fail, now: datetime, budget: Budget, *, blames_hosts: bool
) -> bool:
    """Records a worker failure: the same attempt is repeated after a pause, or the job is quarantined."""
    crashes, host = row.crashes + 1, host_of(row.sid)
    is_last = crashes >= budget.crashes and (
        not blames_hosts
        or hosts.has_failed_everywhere(connection, row, host=host, most=budget.crashes, now=now)
        or (crashes >= _CRASHES_ALONE and hosts.is_alone(connection, host, now))
    )
    last = f"{report.reason}: {report.detail}"
    why = f"quarantined after {crashes} worker failures; the last was {last}" if is_last else ""
    pause_s = min(hosts.LONGEST_PAUSE_S, _CRASH_PAUSE_S * 2 ** (crashes - 1))
    values = {"next_attempt": row.attempt, "until": now.timestamp() + pause_s, "why": why}
    if not _settle(connection, _QUARANTINE if is_last else _WORKER_FAILED, row, report, now, values, settles=False):
        return False
    if blames_hosts:
        hosts.strike(connection, host, job=row, reason=last, now=now)
    return True


def _release(connection: Connection, row: JobRow, report: Fail, now: datetime) -> bool:
    return _settle(connection, _RELEASE, row, report, now, {"until": now.timestamp()}, settles=False)


def _settle(
    connection: Connection,
    how: Transition,
    row: JobRow,
    report: Fail,
    now: datetime,
    values: Mapping[str, Any],
    *,
    settles: bool,
) -> bool:
    """Applies the transition and inserts the attempt with its reason; returns whether the lease was in force."""
    detail = f"{report.reason}: {report.detail}"
    lease = lease_parameters(report.lease)
    if how.make(connection, {**lease, **values}, now, by=report.sid, detail=detail) is None:
        return False
    record_attempt(
        connection,
        row,
        report.reason,
        now,
        settles=settles,
        detail=report.detail,
        steps=report.steps,
        seconds=report.seconds,
    )
    return True
