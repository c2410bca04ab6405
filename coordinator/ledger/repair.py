"""Updates a ledger that lags behind its archive, with the transitions of `states.TRANSITIONS`.

An empty ledger, which replaces a lost one, is updated in the same way. The module does not validate files; the caller
has validated them.
"""

from __future__ import annotations

import secrets
from collections.abc import Iterable, Iterator, Mapping, Sequence
from datetime import datetime
from types import MappingProxyType
from typing import Any

from sqlalchemy import Row, bindparam, insert, select, update
from sqlalchemy.engine import Connection

from coordinator.expansion.catalog import Catalog
from coordinator.expansion.draw import PlannedJob, redraw
from coordinator.ledger import outcomes
from coordinator.ledger.claims import lease_of
from coordinator.ledger.opening import insert_planned, planned_of
from coordinator.ledger.states import Event, JobState
from coordinator.ledger.tables import attempts, jobs
from coordinator.ledger.transitions import FREED, Transition
from schemas.dataset.rows import BundleReceipt, FailedAttempt
from schemas.job import episode_id
from schemas.plan import Plan
from schemas.protocol.messages import Done
from schemas.terms import FailReason

REPAIRER = "repair"
"""Value of the session id column for changes by a repair."""
_LEASE_S = 60.0
_AS_READ = (jobs.c.id == bindparam("of_job"), jobs.c.fence == bindparam("of_fence"))
_TAKE = Transition(
    Event.CLAIMED,
    *_AS_READ,
    fence=jobs.c.fence + 1,
    token=bindparam("of_token"),
    sid=bindparam("by"),
    lease_until=bindparam("until"),
    attempt=bindparam("next_attempt"),
)
_EXHAUST = Transition(
    Event.EXHAUSTED, *_AS_READ, **FREED, superseded=bindparam("has_successor"), reason=bindparam("why"), losses=0
)
_FREE: Mapping[JobState, Transition] = MappingProxyType(
    {
        **{
            held: Transition(Event.RELEASED, *_AS_READ, **FREED, not_before=0.0)
            for held in (JobState.LEASED, JobState.SUBMITTED)
        },
        **{
            ended: Transition(Event.RETRIED, *_AS_READ, **FREED, not_before=0.0, reason="")
            for ended in (JobState.FAILED, JobState.CANCELLED)
        },
    }
)
_WORLD = frozenset(reason.value for reason in FailReason if reason.is_task_failure)
_SOURCE = "according to attempts.parquet"


def current_job(connection: Connection, index: int) -> Row[Any] | None:
    """Returns the current job of an episode, the one that is not superseded."""
    return connection.execute(select(jobs).where(jobs.c.idx == index, jobs.c.superseded.is_(False))).first()


def obstacle_to(connection: Connection, index: int, draw: int, attempt: int, *, replaces: bool = False) -> str:
    """Returns the reason why an intact file of an attempt cannot become the episode; empty if it can.

    Args:
        connection: connection to the ledger.
        index: number of the episode.
        draw: draw of the file.
        attempt: attempt of the file.
        replaces: whether the file may replace the file that the ledger records.
    """
    row = current_job(connection, index)
    if row is None:
        return "the plan has no such episode"
    if row.state == JobState.ARCHIVED and not replaces:
        return "the ledger records another file of the episode"
    if row.draw > draw:
        return f"the ledger has recorded draw {draw} of the episode as failed"
    if row.attempt > attempt:
        return f"the ledger has recorded attempt {attempt} of the episode as failed"
    return ""


def record_whole(
    connection: Connection,
    plan: Plan,
    catalog: Catalog,
    receipt: BundleReceipt,
    now: datetime,
    at: tuple[int, int],
    *,
    replaces: bool = False,
) -> str:
    """Records a validated file as its episode, even if the ledger is at an earlier draw or attempt.

    Args:
        connection: connection with an open transaction.
        plan: plan of the run.
        catalog: compiled scenes of the plan.
        receipt: receipt of the validated file.
        now: time of the repair.
        at: draw and attempt of the file.
        replaces: whether the file may replace the file that the ledger records.

    Returns:
        The reason if the file cannot be recorded, else an empty string.
    """
    draw, attempt = at
    obstacle = obstacle_to(connection, receipt.index, draw, attempt, replaces=replaces)
    if obstacle:
        return obstacle
    outcomes.lose(connection, receipt.index, now, "the dataset has a different intact file of the episode")
    row = _take(
        connection,
        _advance_to_draw(connection, plan, catalog=catalog, index=receipt.index, draw=draw, now=now),
        attempt,
        now,
    )
    done = Done(sid=REPAIRER, lease=lease_of(row), sha256=receipt.file_sha256, size=receipt.file_bytes)
    outcomes.announce(connection, done, now, _LEASE_S)
    return "" if outcomes.adopt(connection, row.id, receipt, now) else "the ledger changed during the repair"


def adopt_package(
    connection: Connection, build: Row[Any], sha256: str, size: int, planned: Sequence[PlannedJob], now: datetime
) -> None:
    """Records the stored package of a layout whose build is open.

    Args:
        connection: connection with an open transaction.
        build: job of the build.
        sha256: digest of the package.
        size: size of the package, bytes.
        planned: first draws of the episodes of the layout.
        now: time of the repair.
    """
    if build.state != JobState.PENDING:
        build = _made(_FREE[JobState(build.state)], connection, build, {}, now)
    lease = lease_of(_take(connection, build, build.attempt, now))
    outcomes.announce(connection, Done(sid=REPAIRER, lease=lease, sha256=sha256, size=size), now, _LEASE_S)
    if not outcomes.record_package(connection, lease, announced=sha256, package=sha256, planned=planned, now=now):
        raise AssertionError("the ledger was changed by another writer")


def record_failures(
    connection: Connection,
    plan: Plan,
    catalog: Catalog,
    failures: Iterable[FailedAttempt],
    known: Iterable[FailedAttempt],
    now: datetime,
    whole: Mapping[int, tuple[int, int]],
) -> None:
    """Records failed attempts in a ledger that lags behind, so they are not repeated.

    Args:
        connection: connection with an open transaction.
        plan: plan of the run.
        catalog: compiled scenes of the plan.
        failures: rows of `attempts.parquet` with draws of the plan.
        known: failed attempts in the ledger.
        now: time of the repair.
        whole: mapping of episode to draw and attempt of its intact file; this and later attempts cannot have failed.
    """
    known_keys = {_key(failure) for failure in known}
    by_episode: dict[str, list[FailedAttempt]] = {}
    for failure in failures:
        if _key(failure) not in known_keys:
            by_episode.setdefault(failure.episode_id, []).append(failure)
    for index in range(1, plan.episodes + 1) if by_episode else ():
        reported = by_episode.get(episode_id(index))
        row = current_job(connection, index) if reported else None
        if reported and row is not None:
            end = (row.draw, row.attempt) if row.state == JobState.ARCHIVED else whole.get(index)
            _record_failures_of_episode(
                connection,
                plan,
                catalog=catalog,
                row=row,
                failures=[one for one in reported if _is_before(one, end)],
                now=now,
            )


def _key(failure: FailedAttempt) -> tuple[str, int, int, str, datetime]:
    return failure.episode_id, failure.draw, failure.attempt, failure.reason, failure.at


def _is_before(failure: FailedAttempt, end: tuple[int, int] | None) -> bool:
    if end is None:
        return True
    settles = failure.reason in _WORLD
    return failure.draw <= end[0] and (failure.attempt < end[1] or (not settles and failure.attempt == end[1]))


def _record_failures_of_episode(
    connection: Connection, plan: Plan, catalog: Catalog, row: Row[Any], failures: list[FailedAttempt], now: datetime
) -> None:
    settled = list(_following(row, failures))
    if settled and row.state != JobState.ARCHIVED:
        _catch_up(connection, plan, catalog=catalog, index=row.idx, settled=settled, now=now)
    _insert_attempts(connection, row.idx, failures)


def _following(row: Row[Any], failures: Iterable[FailedAttempt]) -> Iterator[FailedAttempt]:
    """Yields the consecutive attempts that begin with the job's current attempt."""
    by_attempt = {one.attempt: one for one in failures if one.reason in _WORLD and one.draw >= row.draw}
    attempt = row.attempt
    while attempt in by_attempt:
        yield by_attempt[attempt]
        attempt += 1


def _catch_up(
    connection: Connection, plan: Plan, catalog: Catalog, index: int, settled: list[FailedAttempt], now: datetime
) -> None:
    """Sets an episode to the attempt after the last failed one."""
    last = settled[-1]
    recorded = select(attempts.c.attempt).where(
        attempts.c.idx == index, attempts.c.draw == last.draw, attempts.c.settles, attempts.c.outcome.in_(_WORLD)
    )
    tried = len({*connection.execute(recorded).scalars(), *(one.attempt for one in settled if one.draw == last.draw)})
    misses = tried % plan.budget.attempts_per_draw  # a retry by an admin request grants the whole budget again
    is_used = misses == 0
    draw = last.draw + 1 if is_used and last.draw + 1 < plan.budget.draws else last.draw
    row = _advance_to_draw(connection, plan, catalog=catalog, index=index, draw=draw, now=now, attempt=last.attempt + 1)
    row = _take(connection, row, last.attempt + 1, now)
    if is_used and draw == last.draw:
        _exhaust(connection, row, now, has_successor=False)
    else:
        row = _made(_FREE[JobState.LEASED], connection, row, {}, now)
        connection.execute(update(jobs).where(jobs.c.id == row.id).values(misses=misses))


def _insert_attempts(connection: Connection, index: int, failures: Iterable[FailedAttempt]) -> None:
    """Inserts failed attempts of an episode, except those of draws that the ledger does not have."""
    ids = {row.draw: row.id for row in connection.execute(select(jobs.c.draw, jobs.c.id).where(jobs.c.idx == index))}
    ended = select(attempts.c.attempt).where(attempts.c.idx == index, attempts.c.settles)
    seen = set(connection.execute(ended).scalars())
    for row in failures:
        if row.draw not in ids:
            continue
        settles = row.reason in _WORLD and row.attempt not in seen
        if settles:
            seen.add(row.attempt)
        connection.execute(
            insert(attempts),
            {
                "job_id": ids[row.draw],
                "idx": index,
                "draw": row.draw,
                "attempt": row.attempt,
                "fence": 0,
                "outcome": row.reason,
                "settles": settles,
                "detail": row.detail,
                "steps": row.steps,
                "seconds": row.seconds,
                "sid": row.worker,
                "at": row.at.timestamp(),
            },
        )


def _advance_to_draw(
    connection: Connection, plan: Plan, catalog: Catalog, index: int, draw: int, now: datetime, attempt: int = 0
) -> Row[Any]:
    """Sets an episode to a pending draw and returns its job; earlier draws are recorded as exhausted."""
    row = _required(current_job(connection, index))
    if row.state != JobState.PENDING:
        row = _made(_FREE[JobState(row.state)], connection, row, {}, now)
    while row.draw < draw:
        row = _take(connection, row, max(row.attempt, attempt), now)
        _exhaust(connection, row, now, has_successor=True)
        insert_planned(connection, [redraw(plan, catalog, planned_of(row))], now, attempt=row.attempt)
        row = _required(current_job(connection, index))
    return row


def _take(connection: Connection, row: Row[Any], attempt: int, now: datetime) -> Row[Any]:
    values = {
        "of_token": secrets.token_hex(16),
        "by": REPAIRER,
        "until": now.timestamp() + _LEASE_S,
        "next_attempt": attempt,
    }
    return _made(_TAKE, connection, row, values, now)


def _exhaust(connection: Connection, row: Row[Any], now: datetime, *, has_successor: bool) -> None:
    _made(_EXHAUST, connection, row, {"has_successor": has_successor, "why": f"failed earlier, {_SOURCE}"}, now)


def _made(how: Transition, connection: Connection, row: Row[Any], values: Mapping[str, Any], now: datetime) -> Row[Any]:
    which = {"of_job": row.id, "of_fence": row.fence}
    return _required(how.make(connection, {**which, **values}, now, by=REPAIRER, detail="by factory repair"))


def _required(row: Row[Any] | None) -> Row[Any]:
    if row is None:
        raise AssertionError("the ledger was changed by another writer")
    return row
