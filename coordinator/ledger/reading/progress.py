"""Computes the progress of a run from the ledger. Does not write and needs no running coordinator."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from datetime import UTC, datetime
from typing import Any, NamedTuple

from sqlalchemy import ColumnElement, Row, Select, Subquery, func, select
from sqlalchemy.engine import Connection

from coordinator.ledger.administration import is_paused
from coordinator.ledger.archived import count_by_gateway
from coordinator.ledger.claims import HELD_STATES, has_open_jobs
from coordinator.ledger.hosts import troubled
from coordinator.ledger.opening import read_info, recorded_versions
from coordinator.ledger.outcomes import SUCCESS
from coordinator.ledger.states import OPEN_STATES, JobState
from coordinator.ledger.tables import episodes, events, jobs, workers
from coordinator.ledger.tallies import ATTEMPT_COUNTS, JOB_COUNTS, build_counts
from schemas.protocol.status import Progress, WorkerStatus
from schemas.terms import family_of

_RATE_WINDOW_S, _RECENT_S = 600.0, 120.0
_LEAST_EPISODES, _LEAST_S = 2, 5.0
"""Smallest number of episodes, and of seconds, from which a rate is computed."""

_HELD_BY = select(jobs.c.sid, func.count()).where(jobs.c.state.in_(HELD_STATES)).group_by(jobs.c.sid)


class _Pace(NamedTuple):
    """Rate of archived episodes and estimated remaining time."""

    per_hour: float | None
    """Episodes per hour; `None` if it cannot be known yet."""
    eta_s: float | None
    """Remaining time, seconds; `None` if the rate is unknown."""


def read_progress(connection: Connection, now: datetime) -> Progress:
    """Returns the progress of the run.

    Raises:
        UsageError: the database contains no ledger, or one of another format.
    """
    facts = read_info(connection)
    cells = JOB_COUNTS.subquery()
    by_tier = _count_by(connection, cells, "tier")
    counts = sum((Counter(counts_of_tier) for counts_of_tier in by_tier.values()), Counter())
    left = sum(counts[state] for state in OPEN_STATES)
    layouts = build_counts(connection)
    unbuilt = max(0, (facts.episodes or 0) - sum(counts.values()))
    counts[JobState.PENDING] += unbuilt
    left += unbuilt
    known = _workers(connection, now, facts.lease_ttl_s)
    is_worked_on = left == 0 or any(worker.alive for worker in known)
    pace = _pace(connection, now, left, facts.opened_at) if is_worked_on else _Pace(None, None)
    return Progress(
        run=facts.run,
        planned=sum(counts.values()),
        jobs={state.value: counts[state] for state in JobState},
        by_scene=_count_by(connection, cells, "scene", family_of),
        by_tier=by_tier,
        by_split=_count_by(connection, cells, "split"),
        redrawn=connection.execute(_sum_of(cells).where(cells.c.superseded)).scalar_one() or 0,
        attempts=count_attempts(connection),
        workers=known,
        hosts=troubled(connection),
        layouts=layouts,
        by_gateway=dict(count_by_gateway(connection)),
        episodes_per_hour=pace.per_hour,
        eta_s=pace.eta_s,
        finished=not has_open_jobs(connection),
        paused=is_paused(connection),
        sandbox=facts.sandbox,
        versions=recorded_versions(connection),
    )


def without_coordinator(connection: Connection, progress: Progress) -> Progress:
    """Returns the progress of a run whose coordinator has ended: no worker is alive, and no rate or time left is known.

    Args:
        connection: ledger of the run.
        progress: progress that was read from the ledger.
    """
    gone = tuple(worker.model_copy(update={"alive": False}) for worker in progress.workers)
    if progress.finished:
        return progress.model_copy(update={"workers": gone})
    last_event = connection.execute(select(events.c.at).order_by(events.c.id.desc()).limit(1)).scalar()
    times = [worker.last_beat for worker in gone]
    times += [] if last_event is None else [datetime.fromtimestamp(last_event, UTC)]
    since = max(read_info(connection).opened_at, *times) if times else read_info(connection).opened_at
    stopped = {"workers": gone, "episodes_per_hour": None, "eta_s": None, "stopped_at": since}
    return progress.model_copy(update=stopped)


def count_frames(connection: Connection) -> int:
    """Returns the number of frames in the archived episodes."""
    return sum(int(row.steps) for row in _attempts(connection) if row.outcome == SUCCESS)


def count_attempts(connection: Connection) -> dict[str, int]:
    """Returns the number of attempts by outcome: `success` or the fail reason."""
    return {row.outcome: row.attempts for row in _attempts(connection)}


def _attempts(connection: Connection) -> list[Row[Any]]:
    """Returns the number of attempts and the sum of their steps, by outcome."""
    rows = connection.execute(ATTEMPT_COUNTS).all()
    return [row for row in rows if row.attempts]


def _sum_of(cells: Subquery, *columns: ColumnElement[Any]) -> Select[Any]:
    return select(*columns, func.sum(cells.c.jobs)).group_by(*columns)


def _count_by(
    connection: Connection, cells: Subquery, column: str, group_of: Callable[[str], str] = str
) -> dict[str, dict[str, int]]:
    """Returns the job counts by group and state, including states without jobs."""
    groups: dict[str, Counter[str]] = {}
    query = _sum_of(cells, cells.c[column], cells.c.state).where(cells.c.superseded.is_(False), cells.c.jobs > 0)
    for name, state, count in connection.execute(query):
        groups.setdefault(group_of(name), Counter())[state] += int(count)
    return {name: {state.value: groups[name][state] for state in JobState} for name in sorted(groups)}


def _workers(connection: Connection, now: datetime, lease_ttl_s: float) -> tuple[WorkerStatus, ...]:
    held = {row[0]: row[1] for row in connection.execute(_HELD_BY)}
    return tuple(
        WorkerStatus(
            sid=row.sid,
            host=row.host,
            slots=row.slots,
            leased=held.get(row.sid, 0),
            archived=row.archived,
            last_beat=datetime.fromtimestamp(row.last_beat, UTC),
            alive=now.timestamp() - row.last_beat <= lease_ttl_s,
        )
        for row in connection.execute(select(workers).order_by(workers.c.sid))
    )


def _pace(connection: Connection, now: datetime, left: int, opened_at: datetime) -> _Pace:
    """Returns the rate over the elapsed time of this start of the coordinator, and the time left.

    During a run, the rate is that of the last ten minutes, at its end that of the whole start. The time left follows
    the last two minutes, because the last episodes of a run are often the slowest.
    """
    last = connection.execute(select(func.max(episodes.c.archived_at))).scalar()
    if last is None:
        return _Pace(None, None if left else 0.0)
    end = now.timestamp() if left else last
    begin = max(end - _RATE_WINDOW_S, opened_at.timestamp()) if left else opened_at.timestamp()
    per_hour = _rate(connection, begin, end)
    if left == 0:
        return _Pace(per_hour, 0.0)
    recent = _rate(connection, max(begin, end - _RECENT_S), end)
    return _Pace(per_hour, 3600 * left / recent if recent else None)


def _rate(connection: Connection, begin: float, end: float) -> float | None:
    """Returns the rate of archived episodes, 1/h; `None` if time or number are too small to know it."""
    query = select(func.count()).where(episodes.c.archived_at >= begin, episodes.c.archived_at <= end)
    count = int(connection.execute(query).scalar_one())
    return 3600 * count / (end - begin) if count >= _LEAST_EPISODES and end - begin >= _LEAST_S else None
