"""Reads jobs, attempts, events and episodes of the ledger for reports and for the dataset's tables. Does not write."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from datetime import UTC, datetime
from typing import Any

from pydantic import ValidationError
from sqlalchemy import Row, Select, func, select
from sqlalchemy.engine import Connection
from sqlalchemy.sql.base import ReadOnlyColumnCollection

from coordinator.ledger.states import JobState
from coordinator.ledger.tables import IS_EPISODE, attempts, episodes, events, jobs
from coordinator.ledger.tallies import JOB_COUNTS
from schemas.dataset.rows import EpisodeSummary
from schemas.episode_spec import EpisodeSpec
from schemas.errors import WorldError
from schemas.terms import Split, Tier

_YIELD_ROWS = 1000


@dataclass(frozen=True)
class JobFilter:
    """Filter of current draws; an empty field matches any value."""

    states: tuple[JobState, ...] = ()
    """States of the job."""
    scenes: tuple[str, ...] = ()
    """Names of scenes."""
    tiers: tuple[Tier, ...] = ()
    """Spawn tiers."""
    splits: tuple[Split, ...] = ()
    """Splits."""
    index: int | None = None
    """Episode number. It selects all draws of the episode, including superseded ones; other fields are ignored."""


@dataclass(frozen=True)
class JobRecord:
    """Current state of one draw of one episode."""

    index: int
    """Episode number."""
    draw: int
    """Number of the draw."""
    state: JobState
    """Current state."""
    superseded: bool
    episode: EpisodeSpec
    attempt: int
    """Number of the running or next attempt."""
    misses: int
    """Number of task failures of this draw."""
    crashes: int
    """Number of worker failures of this draw."""
    worker: str
    """Session id of the worker that holds or delivered the job; empty if there is none."""
    step: int
    """Number of simulated steps according to the last heartbeat."""
    reason: str
    """Reason of the failure; empty if the draw has not failed."""
    changed_at: datetime
    """Time of the last change of state."""


@dataclass(frozen=True)
class AttemptRecord:
    """Attempt and its outcome."""

    index: int
    """Episode number."""
    draw: int
    """Number of the draw."""
    attempt: int
    """Number of the attempt."""
    outcome: str
    """Outcome: success, a fail reason, expired, cancelled or lost."""
    detail: str
    """Description with measured values."""
    steps: int
    """Number of simulated steps."""
    seconds: float
    """Wall time, seconds."""
    worker: str
    """Session id of the worker."""
    at: datetime
    """Time of the outcome, UTC."""


@dataclass(frozen=True)
class EventRecord:
    """Event of a job."""

    draw: int
    """Number of the draw."""
    attempt: int
    """Number of the attempt."""
    event: str
    """Name of the event."""
    state: JobState
    """State after the event."""
    worker: str
    """Session id of the worker that caused the event; empty for the coordinator."""
    detail: str
    """Description of the event."""
    at: datetime
    """Time of the event, UTC."""


def list_jobs(connection: Connection, wanted: JobFilter, limit: int = 100, offset: int = 0) -> list[JobRecord]:
    """Returns jobs ordered by episode number and draw."""
    query = (
        _filtered(select(jobs).where(IS_EPISODE), wanted).order_by(jobs.c.idx, jobs.c.draw).limit(limit).offset(offset)
    )
    return [_job_record(row) for row in connection.execute(query)]


def count_jobs(connection: Connection, wanted: JobFilter) -> int:
    """Returns the number of current jobs with the states, scenes, tiers and splits of a filter."""
    counts = JOB_COUNTS.subquery()
    query = _matching(select(func.coalesce(func.sum(counts.c.jobs), 0)), counts.c, wanted)
    return int(connection.execute(query).scalar_one())


def read_attempts(connection: Connection, index: int | None = None) -> Iterator[AttemptRecord]:
    """Yields the attempts of one episode, or of all, ordered by episode, attempt and time."""
    query = select(attempts).order_by(attempts.c.idx, attempts.c.attempt, attempts.c.id)
    if index is not None:
        query = query.where(attempts.c.idx == index)
    for row in connection.execution_options(yield_per=_YIELD_ROWS).execute(query):
        _require_text(row)
        yield AttemptRecord(
            index=row.idx,
            draw=row.draw,
            attempt=row.attempt,
            outcome=row.outcome,
            detail=row.detail,
            steps=row.steps,
            seconds=row.seconds,
            worker=row.sid,
            at=_utc(row.at),
        )


def read_events(connection: Connection, index: int) -> Iterator[EventRecord]:
    """Yields the events of all draws of an episode, oldest first."""
    query = (
        select(events, jobs.c.draw)
        .join(jobs, jobs.c.id == events.c.job_id)
        .where(jobs.c.idx == index)
        .order_by(events.c.id)
    )
    for row in connection.execute(query):
        _require_text(row)
        state, at = JobState(row.state), _utc(row.at)
        yield EventRecord(row.draw, row.attempt, event=row.event, state=state, worker=row.sid, detail=row.detail, at=at)


def read_archived(connection: Connection) -> frozenset[int]:
    """Returns the numbers of the archived episodes."""
    return frozenset(connection.execute(select(episodes.c.idx)).scalars())


def read_content_digests(connection: Connection) -> list[str]:
    """Returns the content digests of the archived episodes, ordered by number."""
    return list(connection.execute(select(episodes.c.content_digest).order_by(episodes.c.idx)).scalars())


class LedgerEpisodes:
    """Source of archived episodes for the table writer.

    Args:
        connection: connection for reading.
    """

    def __init__(self, connection: Connection) -> None:
        self._connection = connection

    def rows(self, first: int, last: int) -> Iterator[EpisodeSummary]:
        """Yields the rows of the episodes from `first` to `last`, ascending."""
        query = select(episodes.c.idx, episodes.c.summary).order_by(episodes.c.idx)
        return _summaries(self._connection, query.where(episodes.c.idx.between(first, last)))


def _summaries(connection: Connection, query: Select[Any]) -> Iterator[EpisodeSummary]:
    for index, summary in connection.execute(query.execution_options(yield_per=_YIELD_ROWS)):
        try:
            yield EpisodeSummary.model_validate_json(summary)
        except ValidationError as error:
            raise WorldError(
                f"the ledger's row of episode {index} cannot be read: stop the run and run `factory repair`, which "
                "restores it from the episode's file"
            ) from error


def _filtered(query: Select[Any], wanted: JobFilter) -> Select[Any]:
    return query.where(jobs.c.idx == wanted.index) if wanted.index is not None else _matching(query, jobs.c, wanted)


def _matching(query: Select[Any], columns: ReadOnlyColumnCollection[str, Any], wanted: JobFilter) -> Select[Any]:
    """Restricts a query to current jobs with the states, scenes, tiers and splits of a filter."""
    query = query.where(columns.superseded.is_(False))
    values = {"state": wanted.states, "scene": wanted.scenes, "tier": wanted.tiers, "split": wanted.splits}
    for name, allowed in values.items():
        if allowed:
            query = query.where(columns[name].in_(allowed))
    return query


def _job_record(row: Row[Any]) -> JobRecord:
    _require_text(row)
    return JobRecord(
        index=row.idx,
        draw=row.draw,
        state=JobState(row.state),
        superseded=row.superseded,
        episode=EpisodeSpec.of(row),
        attempt=row.attempt,
        misses=row.misses,
        crashes=row.crashes,
        worker=row.sid or "",
        step=row.step,
        reason=row.reason,
        changed_at=_utc(row.changed_at),
    )


def _require_text(row: Row[Any]) -> None:
    """Raises `ValueError` for bytes, which SQLite can return from any column of a damaged ledger."""
    wrong = [name for name, value in row._mapping.items() if isinstance(value, bytes)]
    if wrong:
        raise ValueError(f"bytes in the columns {', '.join(wrong)}")


def _utc(seconds: float) -> datetime:
    return datetime.fromtimestamp(seconds, UTC)
