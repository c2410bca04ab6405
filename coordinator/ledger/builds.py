"""Jobs that build the packages of layouts. Each seed that is tried has a row in `jobs`, whose
draw is the position of the seed in the sequence of seeds of the layout.

The module records no outcome; `outcomes` inserts the episodes of a layout when its package is recorded.

Design: docs/design/jobs.md#builds-are-jobs-of-the-ledger.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Sequence
from datetime import datetime
from pathlib import Path
from typing import Any, Protocol

from sqlalchemy import Row, insert, select
from sqlalchemy.engine import Connection

from coordinator.ledger.states import OPEN_STATES, JobState
from coordinator.ledger.tables import BUILD, attempts, jobs
from coordinator.ledger.transitions import is_in
from schemas.errors import TransientError
from schemas.layouts import LAYOUT_SEEDS, LayoutPlan
from schemas.plan import Budget, Plan
from schemas.protocol.messages import MAX_KNOWN_TEXTURES, BuildOrder
from schemas.terms import FailReason

_AFTER_EPISODES = 1.0
"""Due time of a build, seconds since 1970. It is later than 0, the due time of an episode without a failed attempt, so
workers build layouts only when the episodes of the built layouts are done."""


class BuildRow(Protocol):
    """Row of `jobs` of a build."""

    idx: int
    draw: int
    scene: str


def budget_of_builds(budget: Budget) -> Budget:
    """Returns the limits for building a layout: one attempt at each seed, and at most `LAYOUT_SEEDS` seeds."""
    return budget.model_copy(update={"attempts_per_draw": 1, "draws": LAYOUT_SEEDS})


def unbuilt_layouts(plan: Plan, built: Collection[str]) -> list[str]:
    """Returns the layouts of a plan that are not built, in the order of the plan."""
    return [part.name for part in plan.parts if isinstance(part, LayoutPlan) and part.name not in built]


def insert_builds(connection: Connection, plan: Plan, layouts: Iterable[str], now: datetime) -> None:
    """Inserts the builds of layouts as pending jobs."""
    wanted = set(layouts)
    rows = [
        _row(plan.episodes + number, 0, part.name, 1, now)
        for number, part in enumerate(plan.parts, 1)
        if part.name in wanted
    ]
    if rows:
        connection.execute(insert(jobs), rows)


def insert_next_seed(connection: Connection, refused: BuildRow, now: datetime, attempt: int) -> None:
    connection.execute(insert(jobs), [_row(refused.idx, refused.draw + 1, refused.scene, attempt, now)])


def _row(index: int, draw: int, layout: str, attempt: int, now: datetime) -> dict[str, Any]:
    columns = dict.fromkeys(("category", "target_id", "colour", "template_id", "instruction"), "")
    return {
        "idx": index,
        "draw": draw,
        "scene": layout,
        "tier": BUILD,
        "split": BUILD,
        **columns,
        "state": JobState.PENDING,
        "attempt": attempt,
        "not_before": _AFTER_EPISODES,
        "changed_at": now.timestamp(),
    }


def order_of(plan: Plan, row: BuildRow, known: Collection[str] = ()) -> BuildOrder:
    """Returns the order of a build for a worker.

    Args:
        plan: plan of the run.
        row: job of the build.
        known: SHA-256 of textures that the worker need not send.

    Raises:
        TransientError: the file of category rules cannot be read now.
    """
    part = plan.part(row.scene)
    if not isinstance(part, LayoutPlan):
        raise TypeError(f"{row.scene} is not a layout")
    rules = None if part.rules is None else _read_rules(Path(part.rules))
    return BuildOrder(
        layout=part.name,
        family=part.family.name,
        seed=part.seeds[row.draw],
        rules=rules,
        textures=tuple(sorted(known)[:MAX_KNOWN_TEXTURES]),
    )


def _read_rules(path: Path) -> str:
    try:
        return path.read_text(encoding="utf-8")
    except (OSError, ValueError) as error:
        raise TransientError(f"{path} cannot be read: {error}; restore the file of category rules") from error


def number_of_layout(plan: Plan, row: BuildRow) -> int:
    """Returns the place of the layout of a build in `plan.parts`."""
    return row.idx - plan.episodes - 1


def open_builds(connection: Connection) -> Sequence[Row[Any]]:
    query = select(jobs).where(jobs.c.tier == BUILD, jobs.c.superseded.is_(False), is_in(*OPEN_STATES))
    return connection.execute(query).all()


def built_layouts(connection: Connection, episodes: int) -> dict[str, str]:
    """Returns the SHA-256 of the recorded package of each layout that workers have built.

    Args:
        connection: open ledger.
        episodes: number of planned episodes; builds have larger numbers, so no job of an episode is read.
    """
    query = select(jobs.c.scene, jobs.c.sha256, jobs.c.state).where(jobs.c.idx > episodes, jobs.c.tier == BUILD)
    return {row.scene: row.sha256 for row in connection.execute(query) if row.state == JobState.ARCHIVED}


def refused_seeds(connection: Connection) -> dict[str, tuple[str, ...]]:
    """Returns the reasons why seeds of layouts were not used, by layout."""
    query = (
        select(jobs.c.scene, attempts.c.detail)
        .join(attempts, attempts.c.job_id == jobs.c.id)
        .where(jobs.c.tier == BUILD, attempts.c.outcome == FailReason.LAYOUT)
        .order_by(jobs.c.idx, jobs.c.draw)
    )
    seeds: dict[str, tuple[str, ...]] = {}
    for layout, detail in connection.execute(query):
        seeds[layout] = (*seeds.get(layout, ()), detail)
    return seeds
