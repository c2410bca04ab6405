"""Reads the ledger for people and for the dataset's tables: jobs, their attempts, their history. Writes nothing."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from datetime import UTC, datetime
from typing import Any

from pydantic import ValidationError
from sqlalchemy import Row, Select, func, select
from sqlalchemy.engine import Connection

from coordinator.ledger.states import JobState
from coordinator.ledger.tables import attempts, episodes, events, jobs
from schemas.dataset import EpisodeSummary
from schemas.episode_spec import EpisodeSpec
from schemas.errors import WorldError
from schemas.terms import Split, Tier

__all__ = [
    "AttemptRecord",
    "EventRecord",
    "JobFilter",
    "JobRecord",
    "LedgerEpisodes",
    "count_jobs",
    "list_jobs",
    "read_archived",
    "read_attempts",
    "read_events",
    "read_summaries",
]

_YIELD_ROWS = 1000


@dataclass(frozen=True)
class JobFilter:
    """Which current draws are meant; an empty field means any."""

    states: tuple[JobState, ...] = ()
    scenes: tuple[str, ...] = ()
    tiers: tuple[Tier, ...] = ()
    splits: tuple[Split, ...] = ()
    index: int | None = None
    """When given, all draws of that episode are meant, superseded ones too."""


@dataclass(frozen=True)
class JobRecord:
    """One draw of one episode as it stands."""

    index: int
    draw: int
    state: JobState
    superseded: bool
    episode: EpisodeSpec
    attempt: int
    """The attempt that is running, or that comes next."""
    misses: int
    """Attempts of this draw that the world refused."""
    crashes: int
    worker: str
    """Session id of the worker that holds it or brought it; empty when none does."""
    step: int
    """Steps simulated, as last reported."""
    reason: str
    changed_at: datetime


@dataclass(frozen=True)
class AttemptRecord:
    """One attempt and how it ended."""

    index: int
    draw: int
    attempt: int
    outcome: str
    detail: str
    steps: int
    seconds: float
    worker: str
    at: datetime


@dataclass(frozen=True)
class EventRecord:
    """One line of a job's history."""

    draw: int
    attempt: int
    event: str
    state: JobState
    worker: str
    detail: str
    at: datetime


def list_jobs(connection: Connection, wanted: JobFilter, limit: int = 100, offset: int = 0) -> list[JobRecord]:
    """Returns jobs in the order of their episodes."""
    query = _filtered(select(jobs), wanted).order_by(jobs.c.idx, jobs.c.draw).limit(limit).offset(offset)
    return [_job_record(row) for row in connection.execute(query)]


def count_jobs(connection: Connection, wanted: JobFilter) -> int:
    """Returns how many jobs a filter means."""
    return int(connection.execute(_filtered(select(func.count()).select_from(jobs), wanted)).scalar_one())


def read_attempts(connection: Connection, index: int | None = None) -> Iterator[AttemptRecord]:
    """Yields attempts in the order of episode, attempt and time; of one episode, or of all."""
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
    """Yields the history of an episode over all its draws, oldest first."""
    query = (
        select(events, jobs.c.draw)
        .join(jobs, jobs.c.id == events.c.job_id)
        .where(jobs.c.idx == index)
        .order_by(events.c.id)
    )
    for row in connection.execute(query):
        _require_text(row)
        state, at = JobState(row.state), _utc(row.at)
        yield EventRecord(row.draw, row.attempt, row.event, state, row.sid, row.detail, at)


def read_archived(connection: Connection) -> frozenset[int]:
    """Returns the numbers of the archived episodes."""
    return frozenset(connection.execute(select(episodes.c.idx)).scalars())


def read_summaries(connection: Connection) -> Iterator[EpisodeSummary]:
    """Yields the archived episodes in the order of the plan.

    Raises:
        WorldError: a row cannot be understood.
    """
    return _summaries(connection, select(episodes.c.idx, episodes.c.summary).order_by(episodes.c.idx))


class LedgerEpisodes:
    """The archived episodes as the writer of tables wants them.

    Args:
        connection: for reading.
    """

    def __init__(self, connection: Connection) -> None:
        self._connection = connection

    def digests(self) -> Iterator[tuple[int, str]]:
        """Yields number and SHA-256 of the file of each episode, in ascending order."""
        query = select(episodes.c.idx, episodes.c.sha256).order_by(episodes.c.idx)
        for row in self._connection.execute(query.execution_options(yield_per=_YIELD_ROWS)):
            yield row.idx, row.sha256

    def rows(self, first: int, last: int) -> Iterator[EpisodeSummary]:
        """Yields the rows of the episodes between two numbers, both included, in ascending order."""
        query = select(episodes.c.idx, episodes.c.summary).order_by(episodes.c.idx)
        return _summaries(self._connection, query.where(episodes.c.idx.between(first, last)))


def _summaries(connection: Connection, query: Select[Any]) -> Iterator[EpisodeSummary]:
    for index, summary in connection.execute(query.execution_options(yield_per=_YIELD_ROWS)):
        try:
            yield EpisodeSummary.model_validate_json(summary)
        except ValidationError as error:
            raise WorldError(
                f"the ledger's row of episode {index} cannot be read: stop the run and run `factory repair`, which "
                "restores "
                "it from the episode's file"
            ) from error


def _filtered(query: Select[Any], wanted: JobFilter) -> Select[Any]:
    if wanted.index is not None:
        return query.where(jobs.c.idx == wanted.index)
    query = query.where(jobs.c.superseded.is_(False))
    columns = {"state": wanted.states, "scene": wanted.scenes, "tier": wanted.tiers, "split": wanted.splits}
    for name, values in columns.items():
        if values:
            query = query.where(jobs.c[name].in_(values))
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
    """Refuses bytes, which SQLite returns from any column of a damaged ledger."""
    wrong = [name for name, value in row._mapping.items() if isinstance(value, bytes)]
    if wrong:
        raise ValueError(f"bytes in the columns {', '.join(wrong)}")


def _utc(seconds: float) -> datetime:
    return datetime.fromtimestamp(seconds, UTC)
