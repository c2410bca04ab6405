"""Reads where recent attempts have failed, for maps. Does not write."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass

from sqlalchemy import func, select
from sqlalchemy.engine import Connection

from coordinator.ledger.outcomes import SUCCESS
from coordinator.ledger.tables import attempts, jobs
from schemas.terms import FailReason

_RECENT_ATTEMPTS = 20_000
_PLACE = re.compile(r"\((-?\d{1,6}\.\d{1,4}), (-?\d{1,6}\.\d{1,4})\) m")
_NOT_SHOWN = (SUCCESS, str(FailReason.RELEASED), str(FailReason.LAYOUT), "cancelled")
"""Outcomes without a location; a refused layout has no map."""


@dataclass(frozen=True)
class FailedPlace:
    """Failed attempt with its location."""

    index: int
    """Episode number."""
    attempt: int
    """Number of the attempt."""
    reason: str
    """Reason of the failure."""
    detail: str
    """Description with measured values."""
    scene: str
    """Name of the scene."""
    target_id: str
    """Target of the job."""
    xy_m: tuple[float, float] | None
    """Location of the robot according to the description, metres; `None` if it has none."""


def read_failures(connection: Connection, scene: str | None = None, limit: int = 500) -> list[FailedPlace]:
    """Returns the newest failed attempts among the last 20,000 attempts, newest first.

    Args:
        connection: open ledger.
        scene: name of the scene; `None` for all scenes.
        limit: largest number of attempts to return.
    """
    columns = (
        attempts.c.idx,
        attempts.c.attempt,
        attempts.c.outcome,
        attempts.c.detail,
        jobs.c.scene,
        jobs.c.target_id,
    )
    oldest = select(func.max(attempts.c.id)).scalar_subquery() - _RECENT_ATTEMPTS
    query = (
        select(*columns)
        .join(jobs, jobs.c.id == attempts.c.job_id)
        .where(attempts.c.id > oldest, attempts.c.outcome.not_in(_NOT_SHOWN))
        .order_by(attempts.c.id.desc())
        .limit(limit)
    )
    if scene is not None:
        query = query.where(jobs.c.scene == scene)
    return [
        FailedPlace(
            row.idx,
            row.attempt,
            reason=row.outcome,
            detail=row.detail,
            scene=row.scene,
            target_id=row.target_id,
            xy_m=place_in(row.detail),
        )
        for row in connection.execute(query)
    ]


def count_failures(connection: Connection) -> Mapping[str, int]:
    """Returns the number of failed attempts among the last 20,000 attempts by scene, largest first."""
    oldest = select(func.max(attempts.c.id)).scalar_subquery() - _RECENT_ATTEMPTS
    number = func.count().label("failed")
    query = (
        select(jobs.c.scene, number)
        .join(attempts, jobs.c.id == attempts.c.job_id)
        .where(attempts.c.id > oldest, attempts.c.outcome.not_in(_NOT_SHOWN))
        .group_by(jobs.c.scene)
        .order_by(number.desc(), jobs.c.scene)
    )
    return {row.scene: row.failed for row in connection.execute(query)}


def place_in(detail: str) -> tuple[float, float] | None:
    """Returns the first location x, y in the description of a failure, metres."""
    # columns for x and y would change the formats of the ledger, of the messages and of `attempts.parquet`
    match = _PLACE.search(detail)
    return None if match is None else (float(match[1]), float(match[2]))
