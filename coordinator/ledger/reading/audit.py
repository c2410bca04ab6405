"""Checks the integrity of a ledger: its file, the values of each column, and the consistency of its tables.

The module only reads. SQLite has no checksums: a file with a flipped bit or a stale page may still open. The audit
therefore compares every value that determines the next simulated attempt with a second value.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from types import MappingProxyType

from sqlalchemy import Boolean, Column, Double, Integer, Table, inspect, make_url, select, text
from sqlalchemy.engine import Connection
from sqlalchemy.exc import DatabaseError, SQLAlchemyError

from coordinator.expansion.catalog import Catalog
from coordinator.expansion.draw import redraw
from coordinator.ledger.database.engine import open_reader, sqlite_files
from coordinator.ledger.opening import planned_digest, planned_of, read_info, require_current_format
from coordinator.ledger.outcomes import SUCCESS
from coordinator.ledger.states import OPEN_STATES, Event, JobState
from coordinator.ledger.tables import BUILD, IS_EPISODE, METADATA, PLANNED, info, jobs
from schemas.errors import FactoryError, UsageError, WorldError
from schemas.plan import Plan
from schemas.terms import FailReason, Split, Tier

_LARGEST = 2**53
_LATEST_S = 32503680000.0
"""Upper limit of times, seconds since 1970: the year 3000."""
_OUTCOMES = (SUCCESS, "expired", "lost", "cancelled", *FailReason)
_ALLOWED: Mapping[tuple[str, str], tuple[str, ...]] = MappingProxyType(
    {
        ("jobs", "state"): tuple(JobState),
        ("jobs", "tier"): (*Tier, BUILD),
        ("jobs", "split"): (*Split, BUILD),
        ("events", "event"): tuple(Event),
        ("events", "state"): tuple(JobState),
        ("attempts", "outcome"): _OUTCOMES,
    }
)
_TASK_FAILURES = ", ".join(f"'{reason}'" for reason in FailReason if reason.is_task_failure)
_OPEN = ", ".join(f"'{state}'" for state in OPEN_STATES)
_ORPHAN = "an event belongs to a job that does not exist"
_RULES: Mapping[str, str] = MappingProxyType(
    {
        "draws of an episode are missing, duplicated or not superseded": """
            SELECT idx FROM jobs GROUP BY idx
            HAVING count(*) != max(draw) + 1 OR min(draw) != 0 OR min(idx) < 1
                OR sum(CASE WHEN superseded THEN 0 ELSE 1 END) != 1
                OR max(CASE WHEN superseded THEN -1 ELSE draw END) != max(draw)""",
        "a superseded draw has not failed": f"SELECT idx FROM jobs WHERE superseded AND state != '{JobState.FAILED}'",
        "an archived job has no matching row of its episode": f"""
            SELECT jobs.idx FROM jobs LEFT JOIN episodes ON episodes.idx = jobs.idx
            WHERE jobs.state = '{JobState.ARCHIVED}' AND jobs.tier != '{BUILD}'
                AND (episodes.idx IS NULL OR episodes.job_id != jobs.id OR episodes.attempt != jobs.attempt)""",
        "an episode has a row but its job is not archived": f"""
            SELECT episodes.idx FROM episodes LEFT JOIN jobs ON jobs.id = episodes.job_id
            WHERE jobs.id IS NULL OR jobs.idx != episodes.idx OR jobs.superseded
                OR jobs.state != '{JobState.ARCHIVED}'""",
        "a job is not in the state of its last event": f"""
            SELECT jobs.idx FROM jobs JOIN events ON events.id =
                (SELECT max(last.id) FROM events AS last WHERE last.job_id = jobs.id)
            WHERE NOT jobs.superseded AND jobs.state != '{JobState.ARCHIVED}'
                AND (events.state != jobs.state OR events.fence != jobs.fence OR events.attempt > jobs.attempt)""",
        "a job without events is not pending": f"""
            SELECT jobs.idx FROM jobs WHERE jobs.state != '{JobState.PENDING}'
                AND NOT EXISTS (SELECT 1 FROM events WHERE events.job_id = jobs.id)""",
        "a held job has no lease": f"""
            SELECT idx FROM jobs WHERE state IN ('{JobState.LEASED}', '{JobState.SUBMITTED}')
                AND (token IS NULL OR lease_until IS NULL)""",
        "an announced job has no bundle": f"""
            SELECT idx FROM jobs WHERE state IN ('{JobState.SUBMITTED}', '{JobState.ARCHIVED}')
                AND (sha256 IS NULL OR size IS NULL)""",
        "an attempt belongs to another job": """
            SELECT attempts.idx FROM attempts LEFT JOIN jobs ON jobs.id = attempts.job_id
            WHERE jobs.id IS NULL OR jobs.idx != attempts.idx OR jobs.draw != attempts.draw""",
        _ORPHAN: """
            SELECT events.job_id FROM events LEFT JOIN jobs ON jobs.id = events.job_id WHERE jobs.id IS NULL""",
    }
)
"""Mapping of a fault to the query for the numbers of the affected episodes; for `_ORPHAN`, the ids of jobs."""
_SQLITE_RULES: Mapping[str, str] = MappingProxyType(
    {
        "an episode's row and its summary differ": """
            SELECT idx FROM episodes WHERE CASE WHEN json_valid(summary) THEN
                json_extract(summary, '$.index') IS NOT idx
                OR json_extract(summary, '$.file_sha256') IS NOT sha256
                OR json_extract(summary, '$.file_bytes') IS NOT size
                OR json_extract(summary, '$.content_digest') IS NOT content_digest
                ELSE 1 END"""
    }
)
_HISTORY = f"""
    SELECT jobs.idx, jobs.draw, jobs.attempt, jobs.misses, jobs.crashes, jobs.not_before, jobs.changed_at,
        (SELECT max(a.attempt) FROM attempts AS a WHERE a.idx = jobs.idx AND a.settles) AS settled,
        (SELECT count(*) FROM attempts AS a
            WHERE a.job_id = jobs.id AND a.settles AND a.outcome IN ({_TASK_FAILURES})) AS task_failures,
        (SELECT e.attempt FROM events AS e WHERE e.job_id = jobs.id ORDER BY e.id DESC LIMIT 1) AS last_attempt,
        (SELECT count(*) FROM events AS e WHERE e.job_id = jobs.id AND e.event = '{Event.RETRIED}') AS retries,
        (SELECT count(*) FROM events AS e
            WHERE e.job_id = jobs.id AND e.event = '{Event.WORKER_FAILED}') AS worker_failures,
        (SELECT f.attempt FROM jobs AS f WHERE f.idx = jobs.idx AND f.draw = jobs.draw - 1) AS former
    FROM jobs WHERE state IN ({_OPEN}) AND (misses > 0 OR attempt != 1 OR draw > 0 OR crashes != 0 OR not_before > 0
        OR EXISTS (SELECT 1 FROM events AS e WHERE e.job_id = jobs.id))
"""
_BUILT = select(jobs.c.idx, jobs.c.scene).where(jobs.c.tier == BUILD, jobs.c.state == JobState.ARCHIVED)
_LONGEST_PAUSE_S = 3600.0


def ledger_trouble(url: str, catalog: Catalog | None = None) -> str:
    """Returns the reason why a ledger cannot be used; empty if it can.

    Args:
        url: URL of the ledger.
        catalog: scenes of its plan, for the comparison of redrawn jobs with the plan; `None` skips that comparison.

    Raises:
        UsageError: this installation cannot open the database of the URL, or the ledger has another format.
        WorldError: a server cannot be reached.
    """
    if make_url(url).get_backend_name() == "sqlite" and not any(
        path.name == (make_url(url).database or "").rpartition("/")[2] for path in sqlite_files(url)
    ):
        return "is missing"
    engine = open_reader(url)
    try:
        with engine.connect() as connection:
            return find_damage(connection, catalog)
    except DatabaseError as error:
        return f"cannot be read: {error.orig}"
    finally:
        engine.dispose()


def find_damage(connection: Connection, catalog: Catalog | None = None) -> str:
    """Returns a description of the first damage found in an open ledger; empty if there is none.

    Args:
        connection: connection for reading.
        catalog: scenes of its plan, for the comparison of redrawn jobs with the plan; `None` skips that comparison.

    Raises:
        UsageError: the ledger has another format.
    """
    try:
        return next(_findings(connection, catalog), "")
    except UsageError:
        raise
    except DatabaseError as error:
        return f"cannot be read: {error.orig}"
    except (FactoryError, SQLAlchemyError, ValueError, TypeError, LookupError, OverflowError) as error:
        return f"is damaged: {' '.join(str(error).split())}"


def _findings(connection: Connection, catalog: Catalog | None) -> Iterator[str]:
    is_sqlite = connection.dialect.name == "sqlite"
    if is_sqlite:
        result = connection.exec_driver_sql("PRAGMA integrity_check(1)").scalar_one()
        if result != "ok":
            yield f"is damaged: {result}"
    require_current_format(connection)  # before the tables, because an older ledger lacks some of them
    missing = sorted(METADATA.tables.keys() - set(inspect(connection).get_table_names()))
    if missing:
        yield f"lacks the tables {', '.join(missing)}"
    present = [table for table in METADATA.sorted_tables if table.name not in missing]
    for table in present if is_sqlite else ():
        yield from _value_findings(connection, table)
    try:
        plan = read_info(connection).plan
    except WorldError as error:
        yield str(error).removeprefix("the ledger ")
        return
    for what, query in {**_RULES, **(_SQLITE_RULES if is_sqlite else {})}.items():
        row = connection.execute(text(f"{query} LIMIT 1")).first()
        if row is not None:
            yield f"is damaged: {what} ({'job' if what == _ORPHAN else 'episode'} {row[0]})"
    yield from _plan_findings(connection, plan)
    yield from _history_findings(connection, plan)
    if catalog is not None:
        yield from _draw_findings(connection, plan, catalog)


def _value_findings(connection: Connection, table: Table) -> Iterator[str]:
    """Yields a finding for a value outside its column's type, range or vocabulary; SQLite does not enforce them."""
    wrong = [(column.name, _wrong_value(table, column)) for column in table.columns]
    cases = " ".join(f"WHEN {condition} THEN '{name}'" for name, condition in wrong)
    anywhere = " OR ".join(condition for _, condition in wrong)
    query = f"SELECT rowid, CASE {cases} END FROM {table.name} WHERE {anywhere} LIMIT 1"
    row = connection.exec_driver_sql(query).first()
    if row is not None:
        yield f"is damaged: row {row[0]} of {table.name} has a wrong value of {row[1]}"


def _wrong_value(table: Table, column: Column[object]) -> str:
    """Returns the SQL condition for invalid values of a column."""
    name = f'"{column.name}"'
    match column.type:
        case Boolean():
            wrong = f"typeof({name}) != 'integer' OR {name} NOT IN (0, 1)"
        case Integer():
            wrong = f"typeof({name}) != 'integer' OR {name} NOT BETWEEN 0 AND {_LARGEST}"
        case Double():
            wrong = f"typeof({name}) NOT IN ('real', 'integer') OR {name} NOT BETWEEN 0 AND {_LATEST_S}"
        case _:
            wrong = f"typeof({name}) != 'text' OR instr({name}, char(0))"
    allowed = _ALLOWED.get((table.name, column.name))
    if allowed is not None:
        wrong += f" OR {name} NOT IN ({', '.join(repr(str(value)) for value in allowed)})"
    return f"({name} IS NOT NULL AND ({wrong}))" if column.nullable else f"({name} IS NULL OR {wrong})"


def _plan_findings(connection: Connection, plan: Plan) -> Iterator[str]:
    noted = connection.execute(select(info.c.value).where(info.c.key == PLANNED)).scalar()
    if noted != planned_digest(connection):
        yield "is damaged: its jobs are not those of the plan"
    for row in connection.execute(_BUILT).all():
        noted = connection.execute(select(info.c.value).where(info.c.key == f"{PLANNED}:{row.idx}")).scalar()
        if noted != planned_digest(connection, plan.spans[row.scene]):
            yield f"is damaged: its jobs of layout {row.scene} are not those of the plan"
    over = (jobs.c.draw >= plan.budget.draws) & IS_EPISODE
    for row in connection.execute(select(jobs.c.idx, jobs.c.draw).where(over).limit(1)):
        yield f"is damaged: episode {row.idx} has draw {row.draw}, and the plan allows {plan.budget.draws}"


def _history_findings(connection: Connection, plan: Plan) -> Iterator[str]:
    """Compares the counters of open jobs with their recorded attempts and events."""
    for row in connection.execute(text(_HISTORY)):
        attempt = row.last_attempt if row.last_attempt is not None else row.former if row.draw else 1
        # the attempt number changes without an event when a draw begins, and in `record_failures`
        if row.attempt <= (row.settled or 0) or (attempt is not None and row.attempt < attempt):
            yield f"is damaged: episode {row.idx} is at attempt {row.attempt}, which has ended"
        expected = max(attempt or 1, (row.settled or 0) + 1)
        if row.attempt > expected:
            yield f"is damaged: episode {row.idx} is at attempt {row.attempt}, but its attempts give {expected}"
        failures = row.task_failures
        if row.misses > failures or (not row.retries and row.misses != failures % plan.budget.attempts_per_draw):
            yield f"is damaged: episode {row.idx} counts {row.misses} task failures, but {failures} are recorded"
        failures = row.worker_failures
        if row.crashes > failures + (plan.budget.crashes if row.retries else 0):
            yield f"is damaged: episode {row.idx} counts {row.crashes} worker failures, but {failures} are recorded"
        if row.not_before > row.changed_at + _LONGEST_PAUSE_S:
            yield (
                f"is damaged: the pause of episode {row.idx} ends {row.not_before - row.changed_at:.0f} s after its "
                f"last change, but the longest pause is {_LONGEST_PAUSE_S:.0f} s"
            )


def _draw_findings(connection: Connection, plan: Plan, catalog: Catalog) -> Iterator[str]:
    """Repeats every redraw and compares the result with the ledger.

    A redraw depends only on the plan, the scene, the episode number and the number of the draw.
    """
    later = select(jobs).where(jobs.c.draw > 0, IS_EPISODE).order_by(jobs.c.idx, jobs.c.draw)
    for row in connection.execute(later).all():
        if row.scene not in catalog:
            continue
        before = connection.execute(select(jobs).where(jobs.c.idx == row.idx, jobs.c.draw == row.draw - 1)).one()
        if planned_of(row) != redraw(plan, catalog, planned_of(before)):
            yield f"is damaged: draw {row.draw} of episode {row.idx} is not that of the plan"
