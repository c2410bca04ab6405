"""Reads cells, running jobs, events and recent attempts of a run for the web page. Does not write.

Every query takes about the same time for any number of jobs: it reads tallies, an index, or the newest rows only.
"""

from __future__ import annotations

from collections import Counter, defaultdict
from dataclasses import dataclass
from datetime import UTC, datetime
from typing import Any

from sqlalchemy import ColumnElement, Integer, cast, func, select
from sqlalchemy.engine import Connection

from coordinator.ledger.administration import RecordedRequest, read_requests
from coordinator.ledger.claims import HELD_STATES
from coordinator.ledger.hosts import read_memory
from coordinator.ledger.outcomes import SUCCESS
from coordinator.ledger.tables import BUILD, attempts, events, jobs, workers
from coordinator.ledger.tallies import JOB_COUNTS
from schemas.protocol.messages import HostMemory

_RECENT_ATTEMPTS = 20_000
_EVENTS = 60
_MOST_RUNNING = 2000
_INTERVALS = 48
_LEAST_INTERVAL_S = 10.0
_RATE_S = 600.0


@dataclass(frozen=True)
class RunningJob:
    """Job that a worker holds."""

    index: int
    """Episode number."""
    scene: str
    """Name of the scene."""
    is_build: bool
    """Whether the job builds the scene; then `index` is not an episode."""
    step: int
    """Number of simulated steps according to the last heartbeat."""
    state: str
    """State of the job."""


@dataclass(frozen=True)
class FarmEvent:
    """Event of a job, with its episode or the layout that it builds."""

    index: int
    """Episode number."""
    scene: str
    """Name of the scene."""
    is_build: bool
    """Whether the job builds the scene; then `index` is not an episode."""
    event: str
    """Name of the event."""
    state: str
    """State after the event."""
    attempt: int
    """Number of the attempt."""
    worker: str
    """Session id of the worker that caused the event; empty for the coordinator."""
    detail: str
    """Description of the event."""
    at: datetime
    """Time of the event, UTC."""


@dataclass(frozen=True)
class Interval:
    """Attempts that ended in an interval of time."""

    begin: datetime
    """Start of the interval, UTC."""
    end: datetime
    """End of the interval, UTC."""
    archived: int
    """Number of successful attempts."""
    failures: dict[str, int]
    """Number of other attempts by outcome."""


@dataclass(frozen=True)
class FarmReading:
    """State of a farm, in addition to its progress."""

    cells: dict[tuple[str, str, str], dict[str, int]]
    """(scene, tier, split) -> state -> number of current draws. The numbers of a cell add up to its quota."""
    running: dict[str, tuple[RunningJob, ...]]
    """Held jobs by the session id of their worker."""
    versions: dict[str, str]
    """Software version by session id."""
    frames_per_s: dict[str, float]
    """Simulated frames per second by session id, over the last ten minutes."""
    events: tuple[FarmEvent, ...]
    """Newest events, newest first."""
    history: tuple[Interval, ...]
    """Recent attempts over time, oldest first; empty without attempts."""
    requests: tuple[RecordedRequest, ...]
    """Newest admin requests, newest first."""
    memory: dict[str, HostMemory]
    """Memory by name of the host."""


def read_farm(connection: Connection, now: datetime) -> FarmReading:
    return FarmReading(
        cells=_cells(connection),
        running=_running(connection),
        versions={row.sid: row.version for row in connection.execute(select(workers.c.sid, workers.c.version))},
        frames_per_s=_rates(connection, now.timestamp()),
        events=_events(connection),
        history=_history(connection),
        requests=read_requests(connection)[::-1],
        memory=read_memory(connection),
    )


def _recent() -> ColumnElement[bool]:
    """Returns the SQL condition that selects the newest attempts."""
    return attempts.c.id > select(func.max(attempts.c.id)).scalar_subquery() - _RECENT_ATTEMPTS


def _cells(connection: Connection) -> dict[tuple[str, str, str], dict[str, int]]:
    cells: defaultdict[tuple[str, str, str], Counter[str]] = defaultdict(Counter)
    for row in connection.execute(JOB_COUNTS):
        if not row.superseded and row.jobs:
            cells[row.scene, row.tier, row.split][row.state] += row.jobs
    return {cell: dict(cells[cell]) for cell in sorted(cells)}


def _running(connection: Connection) -> dict[str, tuple[RunningJob, ...]]:
    columns = (jobs.c.sid, jobs.c.idx, jobs.c.scene, jobs.c.tier, jobs.c.step, jobs.c.state)
    held = select(*columns).where(jobs.c.state.in_(HELD_STATES)).order_by(jobs.c.idx).limit(_MOST_RUNNING)
    running: defaultdict[str, list[RunningJob]] = defaultdict(list)
    for row in connection.execute(held):
        running[row.sid or ""].append(
            RunningJob(row.idx, row.scene, is_build=row.tier == BUILD, step=row.step, state=row.state)
        )
    return {sid: tuple(rows) for sid, rows in running.items()}


def _events(connection: Connection) -> tuple[FarmEvent, ...]:
    of_job = (jobs.c.idx, jobs.c.scene, jobs.c.tier)
    columns = (*of_job, events.c.event, events.c.state, events.c.attempt, events.c.sid, events.c.detail, events.c.at)
    query = select(*columns).join(jobs, jobs.c.id == events.c.job_id).order_by(events.c.id.desc()).limit(_EVENTS)
    return tuple(
        FarmEvent(
            row.idx,
            row.scene,
            is_build=row.tier == BUILD,
            event=row.event,
            state=row.state,
            attempt=row.attempt,
            worker=row.sid,
            detail=row.detail,
            at=datetime.fromtimestamp(row.at, UTC),
        )
        for row in connection.execute(query)
    )


def _rates(connection: Connection, now: float) -> dict[str, float]:
    steps = func.sum(attempts.c.steps).label("steps")
    query = select(attempts.c.sid, steps).where(_recent(), attempts.c.at >= now - _RATE_S).group_by(attempts.c.sid)
    return {row.sid: row.steps / _RATE_S for row in connection.execute(query)}


def _history(connection: Connection) -> tuple[Interval, ...]:
    query = select(func.min(attempts.c.at), func.max(attempts.c.at)).where(_recent())
    first, last = connection.execute(query).one()
    if first is None:
        return ()
    width = max((last - first) / _INTERVALS, _LEAST_INTERVAL_S)
    place = _whole((attempts.c.at - first) / width, connection).label("place")
    number = func.count().label("attempts")
    counted = select(place, attempts.c.outcome, number).where(_recent()).group_by(place, attempts.c.outcome)
    counts = [Counter[str]() for _ in range(int((last - first) / width) + 1)]
    for row in connection.execute(counted):
        counts[min(int(row.place), len(counts) - 1)][row.outcome] += row.attempts
    return tuple(
        Interval(
            datetime.fromtimestamp(first + place * width, UTC),
            datetime.fromtimestamp(min(first + (place + 1) * width, last), UTC),
            count[SUCCESS],
            {outcome: number for outcome, number in sorted(count.items()) if outcome != SUCCESS},
        )
        for place, count in enumerate(counts)
    )


def _whole(value: ColumnElement[Any], connection: Connection) -> ColumnElement[Any]:
    """Rounds a non-negative number down; a cast would round to the nearest integer in PostgreSQL."""
    return cast(value, Integer) if connection.dialect.name == "sqlite" else func.floor(value)
