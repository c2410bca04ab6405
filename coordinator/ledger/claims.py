"""Grants, extends and expires leases on jobs. Does not record outcomes of attempts."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from datetime import datetime
from typing import Any

from sqlalchemy import Row, bindparam, case, or_, select, update
from sqlalchemy.engine import Connection

from coordinator.ledger.database.prepared import PreparedStatement
from coordinator.ledger.states import OPEN_STATES, Event, JobState
from coordinator.ledger.tables import IS_EPISODE, events, jobs
from coordinator.ledger.transitions import (
    FREED,
    JOB,
    UNDER_LEASE,
    JobRow,
    Transition,
    is_in,
    lease_parameters,
    record_attempt,
)
from schemas.protocol.keys import host_of
from schemas.protocol.messages import Beat, Lease

HELD_STATES = (JobState.LEASED, JobState.SUBMITTED)
GRACE = 1.5
"""Duration of leases after a restart, in multiples of the normal duration of a lease. It is more than 1, because no
heartbeat arrived during the downtime; the half beyond 1 leaves a worker with leases of 15 s time for its next heartbeat
(at most 4.5 s), and for one that is lost (2 s)."""
_EXPIRED = "expired"
_SWEEP_ROWS = 500
_FIRST_BACKOFF_S, _LONGEST_BACKOFF_S = 0.05, 30.0
"""Pause of a job after its first expired lease, and the longest pause, seconds. The pause doubles with each consecutive
expired lease of the job."""
# the first is short, because most workers are lost without a fault of the job; from the eleventh on, a job that stops
# its workers costs at most one lease in half a minute
_LONGEST_REST_S = 600.0
"""`grant_grace` ends pauses of jobs that would last longer than this, seconds. Normal pauses are shorter."""

BY_TOKEN = select(*JOB).where(jobs.c.token == bindparam("of_token"))
NEXT_ID = (
    select(jobs.c.id)
    .where(jobs.c.state == JobState.PENDING, jobs.c.not_before <= bindparam("now"))
    .order_by(jobs.c.not_before, jobs.c.id)
    .limit(1)
)
NEXT_EPISODE_ID = NEXT_ID.where(IS_EPISODE)
ANY_OPEN = select(jobs.c.id).where(is_in(*OPEN_STATES)).limit(1)
_BY_IDS = select(jobs).where(jobs.c.id.in_(bindparam("ids", expanding=True)))
_BEAT = (
    update(jobs)
    .where(*UNDER_LEASE, is_in(*HELD_STATES))
    .values(lease_until=bindparam("until"), step=bindparam("at_step"), sid=bindparam("by"))
)
OVERDUE = select(jobs).where(jobs.c.lease_until < bindparam("now")).order_by(jobs.c.lease_until).limit(_SWEEP_ROWS)
_CLAIMED_BEFORE = (
    select(jobs)
    .join(events, (events.c.job_id == jobs.c.id) & (events.c.fence == jobs.c.fence))
    .where(
        is_in(*HELD_STATES),
        events.c.event == Event.CLAIMED,
        or_(events.c.at < bindparam("before"), events.c.at > bindparam("now")),
    )
    .order_by(jobs.c.id)
    .limit(_SWEEP_ROWS)
)
_HOLDER = PreparedStatement(BY_TOKEN)
_LONGER = case((jobs.c.lease_until < bindparam("until"), bindparam("until")), else_=jobs.c.lease_until)
_EXTEND = PreparedStatement(update(jobs).where(*UNDER_LEASE, is_in(*HELD_STATES)).values(lease_until=_LONGER))
_CLAIM, _CLAIM_EPISODE = (
    Transition(
        Event.CLAIMED,
        jobs.c.id == next_id.scalar_subquery(),
        fence=jobs.c.fence + 1,
        token=bindparam("of_token"),
        sid=bindparam("by"),
        lease_until=bindparam("until"),
    )
    for next_id in (NEXT_ID, NEXT_EPISODE_ID)
)
_EXPIRE = Transition(
    Event.EXPIRED,
    *UNDER_LEASE,
    jobs.c.lease_until < bindparam("now"),
    **FREED,
    losses=jobs.c.losses + 1,
    not_before=bindparam("until"),
)


@dataclass(frozen=True)
class BeatOutcome:
    """Outcome of a heartbeat."""

    lost: tuple[Lease, ...]
    """Leases of running jobs that are not in force."""
    drop: tuple[Lease, ...]
    """Leases of spooled bundles that are not in force."""
    waiting: tuple[Row[Any], ...]
    """Jobs whose announced bundle is not pulled yet."""


def lease_of(row: JobRow) -> Lease:
    """Returns the lease in force on a held job."""
    return Lease(job_id=row.id, fence=row.fence, token=row.token)


def claim(
    connection: Connection,
    sid: str,
    token: str,
    now: datetime,
    ttl_s: float,
    *,
    may_start: bool = True,
    can_build: bool = True,
) -> JobRow | None:
    """Leases the job that has waited longest, or returns the job that the token already holds.

    Args:
        connection: connection with an open transaction.
        sid: session id of the worker.
        token: token that the worker chose; a repeated claim carries the same token.
        now: time of the claim.
        ttl_s: duration of the lease without a heartbeat, seconds.
        may_start: whether the function may lease a job that the token does not hold yet.
        can_build: whether the function may lease the build of a layout.

    Returns:
        The job's row. `None` if no job is due or may be started, if the job of the token is no longer held, or if the
        token belongs to another host.
    """
    known = _HOLDER.first(connection, {"of_token": token})
    if known is not None:
        is_theirs = known.state in HELD_STATES and host_of(known.sid) == host_of(sid)
        return known if is_theirs else None
    if not may_start:
        return None
    lease = {"of_token": token, "by": sid, "until": now.timestamp() + ttl_s}
    return (_CLAIM if can_build else _CLAIM_EPISODE).make(connection, lease, now, by=sid)


def beat(connection: Connection, beat: Beat, now: datetime, ttl_s: float) -> BeatOutcome:
    """Extends the leases of a host that are in force; returns the other leases and the bundles not pulled yet.

    A lease belongs to the host that claimed the job; the token of another host has no effect.
    """
    host = host_of(beat.sid)
    named = {lease.job_id for lease in (*(live.lease for live in beat.live), *beat.spool)}
    rows = {row.id: row for row in connection.execute(_BY_IDS, {"ids": sorted(named)})} if named else {}
    live = [item for item in beat.live if _is_held(rows.get(item.lease.job_id), item.lease, host)]
    spool = [lease for lease in beat.spool if _is_held(rows.get(lease.job_id), lease, host)]
    steps = {item.lease: item.step for item in live}
    held = dict.fromkeys((*steps, *spool))
    if held:
        until = now.timestamp() + ttl_s
        _extend_all(connection, [(lease, steps.get(lease, rows[lease.job_id].step)) for lease in held], until, beat.sid)
    waiting = [rows[lease.job_id] for lease in spool if rows[lease.job_id].state == JobState.SUBMITTED]
    return BeatOutcome(
        lost=tuple(item.lease for item in beat.live if item.lease not in held),
        drop=tuple(lease for lease in beat.spool if lease not in held),
        waiting=tuple(waiting),
    )


def extend(connection: Connection, lease: Lease, now: datetime, seconds: float) -> bool:
    """Extends a lease to at least `seconds` from now; returns whether it is in force."""
    return _EXTEND.count(connection, {**lease_parameters(lease), "until": now.timestamp() + seconds}) == 1


def shorten(connection: Connection, sid: str, now: datetime, seconds: float) -> int:
    """Shortens the leases of a worker to at most `seconds` from now, because its connection closed.

    Returns:
        The number of leases that the worker holds.
    """
    until = now.timestamp() + seconds
    sooner = case((jobs.c.lease_until > until, until), else_=jobs.c.lease_until)
    theirs = update(jobs).where(jobs.c.sid == sid, is_in(*HELD_STATES))
    return connection.execute(theirs.values(lease_until=sooner)).rowcount


def grant_grace(connection: Connection, now: datetime, ttl_s: float) -> int:
    """Restarts every lease after a restart of the coordinator, or after the clock was set.

    The function also ends pauses of jobs that would last longer than `_LONGEST_REST_S`, which happens if the clock was
    set back.

    Returns:
        The number of leases.
    """
    far = now.timestamp() + _LONGEST_REST_S
    resting = update(jobs).where(jobs.c.state == JobState.PENDING, jobs.c.not_before > far)
    connection.execute(resting.values(not_before=0.0))
    held = update(jobs).where(is_in(*HELD_STATES))
    return connection.execute(held.values(lease_until=now.timestamp() + GRACE * ttl_s)).rowcount


def expire(connection: Connection, now: datetime) -> int:
    """Expires leases: puts jobs whose lease has ended back into the queue, at most `_SWEEP_ROWS` per call.

    Returns:
        The number of jobs.
    """
    expired = 0
    for row in connection.execute(OVERDUE, {"now": now.timestamp()}).all():
        pause = min(_LONGEST_BACKOFF_S, _FIRST_BACKOFF_S * 2 ** min(row.losses, 16))
        lease = {**lease_parameters(lease_of(row)), "until": now.timestamp() + pause}
        if _EXPIRE.make(connection, lease, now, by=row.sid or "") is not None:
            record_attempt(connection, row, _EXPIRED, now, settles=False, steps=row.step)
            expired += 1
    return expired


def held_too_long(connection: Connection, now: datetime, limit_s: float) -> Sequence[JobRow]:
    """Returns jobs that were claimed longer ago than the limit and are still held, at most `_SWEEP_ROWS`.

    A claim time in the future was recorded before the clock was set back. Such a job is returned too, because the
    caller has checked that the limit has passed since the clock was set.
    """
    at = now.timestamp()
    return connection.execute(_CLAIMED_BEFORE, {"before": at - limit_s, "now": at}).all()


def has_open_jobs(connection: Connection) -> bool:
    """Returns whether any job can still change without an admin request."""
    return connection.execute(ANY_OPEN).first() is not None


def _is_held(row: Row[Any] | None, lease: Lease, host: str) -> bool:
    is_in_force = row is not None and row.state in HELD_STATES and (row.fence, row.token) == (lease.fence, lease.token)
    return is_in_force and row is not None and host_of(row.sid) == host


def _extend_all(connection: Connection, held: Iterable[tuple[Lease, int]], until: float, sid: str) -> None:
    beats = [{**lease_parameters(lease), "until": until, "at_step": step, "by": sid} for lease, step in held]
    connection.execute(_BEAT, beats)
