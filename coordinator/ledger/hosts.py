"""Records the workers of a run, their memory, and failures of hosts: strikes, pauses and bars. Does not change jobs.

A host with a strike gets one job at a time; each episode that it delivers halves its strikes. A failure is attributed
to the job only if the job failed on `budget.crashes` hosts, on all available hosts (at least two), or for a long time
on the only host. Until then it is attributed to the host.

Design: docs/design/jobs.md#failures-count-against-the-host-first.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from datetime import UTC, datetime
from typing import Any

from pydantic import TypeAdapter, ValidationError
from sqlalchemy import Row, bindparam, delete, func, insert, or_, select, update
from sqlalchemy.engine import Connection

from coordinator.ledger.database.prepared import PreparedStatement
from coordinator.ledger.opening import write_info
from coordinator.ledger.states import JobState
from coordinator.ledger.tables import attempts, hosts, info, jobs, workers
from coordinator.ledger.transitions import JobRow, is_in
from schemas.protocol.administration import AdminReply
from schemas.protocol.keys import host_of
from schemas.protocol.messages import Hello, HostMemory
from schemas.protocol.status import HostStatus
from schemas.terms import FailReason

_KEY = "memory"
_BY_HOST = TypeAdapter(dict[str, HostMemory])


def write_memory(connection: Connection, memory: Mapping[str, HostMemory]) -> None:
    """Replaces the memory of all hosts.

    Args:
        connection: connection with an open transaction.
        memory: memory by name of the host.
    """
    write_info(connection, {_KEY: _BY_HOST.dump_json(dict(memory)).decode()})


def read_memory(connection: Connection) -> dict[str, HostMemory]:
    """Returns the memory by name of the host; empty before the first heartbeat."""
    text = connection.execute(select(info.c.value).where(info.c.key == _KEY)).scalar()
    try:
        return _BY_HOST.validate_json(text) if text else {}
    except ValidationError:
        return {}


STRIKES = 8
"""Number of strikes with which a host is barred. The pauses between them add up to at least two minutes."""
LONGEST_PAUSE_S = 60.0
"""Longest pause of a host that is not barred, seconds."""
_FIRST_PAUSE_S = 1.0
_BARRED_PAUSE_S = 30.0
"""Pause of a barred host before its next claim, seconds."""
_ABSENT_S = 300.0
"""Time without a message after which a host is not considered available, seconds."""
_WORKER_FAILURES = tuple(reason.value for reason in FailReason if reason.is_worker_failure)

_FIND = PreparedStatement(select(*hosts.c).where(hosts.c.host == bindparam("name")))
_HALVE_STRIKES = PreparedStatement(
    update(hosts)
    .where(hosts.c.host == bindparam("name"), hosts.c.strikes > 0, hosts.c.barred_at.is_(None))
    .values(strikes=hosts.c.strikes // 2, resumes_at=0.0)
)
SESSIONS, SESSIONS_OF_HOST = 10_000, 2000
"""Maximum numbers of recorded sessions, in total and per host. The total is twice the maximum number of connections."""
_SILENT_S = 300.0
"""Time without a message after which a session may be removed in favour of a new one, seconds."""
_OLDEST = func.min(workers.c.last_beat).label("oldest")
_KNOWN: Any = select(func.count().label("known"), _OLDEST).select_from(workers)
_OF_ALL = PreparedStatement(_KNOWN)
_OF_HOST = PreparedStatement(_KNOWN.where(workers.c.host == bindparam("name")))
_UPDATE_LAST_BEAT = PreparedStatement(
    update(workers).where(workers.c.sid == bindparam("by")).values(last_beat=bindparam("now"))
)


def pause_of(connection: Connection, host: str, now: datetime) -> float:
    """Returns the pause before a host may claim another job, seconds; 0 if it may claim one now."""
    row = _FIND.first(connection, {"name": host})
    if row is None or row.strikes == 0:
        return 0.0
    if row.barred_at is not None:
        return _BARRED_PAUSE_S
    if row.resumes_at > now.timestamp():
        return float(row.resumes_at - now.timestamp())
    return _FIRST_PAUSE_S if _holds_job(connection, host) else 0.0


def strike(connection: Connection, host: str, job: JobRow, reason: str, now: datetime) -> None:
    """Adds a strike to a host. The pause of the host doubles with each strike; the last strike bars it.

    Failures during a pause concern jobs that were leased before it and add no strike.
    """
    at = now.timestamp()
    row = _FIND.first(connection, {"name": host})
    if row is None:
        fresh = {"host": host, "strikes": 0, "last_job": 0, "resumes_at": 0.0, "barred_at": None, "reason": ""}
        connection.execute(insert(hosts), fresh)
    elif row.barred_at is not None or row.resumes_at > at or _is_of_job(connection, host, row=row, job=job, now=now):
        return
    strikes = 1 + (row.strikes if row is not None else 0)
    values = {
        "strikes": strikes,
        "last_job": job.id,
        "resumes_at": at + min(LONGEST_PAUSE_S, _FIRST_PAUSE_S * 2 ** (strikes - 1)),
        "barred_at": at if strikes >= STRIKES else None,
        "reason": reason,
    }
    connection.execute(update(hosts).where(hosts.c.host == host).values(values))


def reduce_strikes(connection: Connection, sid: str) -> None:
    """Halves the strikes of a host that delivered an episode."""
    _HALVE_STRIKES.count(connection, {"name": host_of(sid)})


def release(connection: Connection, names: Sequence[str]) -> AdminReply:
    """Resets the strikes of hosts and lifts their bars.

    Args:
        connection: connection with an open transaction.
        names: names of hosts; empty selects all hosts with strikes.
    """
    known = {row.host for row in _troubled(connection)}
    freed = tuple(sorted(known if not names else known & set(names)))
    if freed:
        clean = {"strikes": 0, "last_job": 0, "resumes_at": 0.0, "barred_at": None, "reason": ""}
        connection.execute(update(hosts).where(hosts.c.host.in_(freed)).values(clean))
    unknown = {name: "neither barred nor limited" for name in names if name not in known}
    return AdminReply(changed=(), hosts=freed, refused_hosts=unknown)


def troubled(connection: Connection) -> tuple[HostStatus, ...]:
    """Returns the hosts with strikes, ordered by name."""
    return tuple(
        HostStatus(
            host=row.host,
            strikes=row.strikes,
            resumes_at=datetime.fromtimestamp(row.resumes_at, UTC),
            barred_at=None if row.barred_at is None else datetime.fromtimestamp(row.barred_at, UTC),
            reason=row.reason,
        )
        for row in _troubled(connection)
    )


def has_failed_everywhere(connection: Connection, job: JobRow, host: str, most: int, now: datetime) -> bool:
    """Returns whether a job failed on at least two hosts and either on `most` hosts or on all available ones.

    Args:
        connection: connection with an open transaction.
        job: row of the job that failed.
        host: host of the failed attempt.
        most: number of hosts whose failures suffice; fewer hosts could all be faulty or hostile.
        now: time of the failure.
    """
    failing = _failing_hosts(connection, job) | {host}
    return len(failing) > 1 and (len(failing) >= most or not _others(connection, failing, now))


def _failing_hosts(connection: Connection, job: JobRow) -> set[str]:
    """Returns the hosts on which a job failed since its crash count was last reset."""
    recent = (
        select(attempts.c.sid)
        .where(attempts.c.job_id == job.id, attempts.c.outcome.in_(_WORKER_FAILURES))
        .order_by(attempts.c.id.desc())
        .limit(job.crashes)
    )
    return {host_of(sid) for sid in connection.execute(recent).scalars()}


def is_alone(connection: Connection, host: str, now: datetime) -> bool:
    return not _others(connection, {host}, now)


def _others(connection: Connection, known: Collection[str], now: datetime) -> bool:
    """Returns whether any host that is not in `known` is available and not barred."""
    barred = select(hosts.c.host).where(hosts.c.barred_at.is_not(None))
    since = now.timestamp() - _ABSENT_S
    others = select(workers.c.sid).where(
        workers.c.host.not_in(known), workers.c.last_beat >= since, workers.c.host.not_in(barred)
    )
    return connection.execute(others.limit(1)).first() is not None


def _is_of_job(connection: Connection, host: str, row: JobRow, job: JobRow, now: datetime) -> bool:
    """Returns whether the last strike of a host was for this job and no other host is available."""
    return bool(row.strikes) and row.last_job == job.id and is_alone(connection, host, now)


def _holds_job(connection: Connection, host: str) -> bool:
    theirs = or_(jobs.c.sid == host, jobs.c.sid.like(f"{host}.%"))
    held = select(func.count()).select_from(jobs).where(is_in(JobState.LEASED, JobState.SUBMITTED), theirs)
    return connection.execute(held).scalar_one() > 0


def _troubled(connection: Connection) -> Sequence[Row[Any]]:
    return connection.execute(select(hosts).where(hosts.c.strikes > 0).order_by(hosts.c.host)).all()


def register(connection: Connection, hello: Hello, now: datetime) -> bool:
    """Records or updates a worker; returns `False` if the maximum number of sessions is reached."""
    values = {"host": hello.host, "slots": hello.slots, "version": hello.version, "last_beat": now.timestamp()}
    if connection.execute(update(workers).where(workers.c.sid == hello.sid).values(values)).rowcount:
        return True
    if not _make_room(connection, hello.host, now):
        return False
    connection.execute(insert(workers).values(sid=hello.sid, **values))
    return True


def note_alive(connection: Connection, sid: str, host: str, now: datetime) -> None:
    """Records the time of a message of a worker, which need not be registered.

    Records nothing for a new session if the maximum number of sessions is reached.
    """
    is_known = _UPDATE_LAST_BEAT.count(connection, {"by": sid, "now": now.timestamp()}) > 0
    if not is_known and _make_room(connection, host, now):
        connection.execute(insert(workers).values(sid=sid, host=host, slots=1, last_beat=now.timestamp()))


def _make_room(connection: Connection, host: str, now: datetime) -> bool:
    """Removes silent sessions if necessary; returns whether another session of a host can be recorded."""
    before = now.timestamp() - _SILENT_S
    of_host, of_all = {"name": host}, dict[str, object]()
    for parameters, count_of, most in ((of_host, _OF_HOST, SESSIONS_OF_HOST), (of_all, _OF_ALL, SESSIONS)):
        row = count_of.first(connection, parameters)
        if row is None or row.known < most:
            continue
        if row.oldest >= before:
            return False
        of_whom = [workers.c.host == host] if parameters else []
        connection.execute(delete(workers).where(*of_whom, workers.c.last_beat < before))
    return True
