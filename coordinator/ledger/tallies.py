"""Counts jobs by state and cell, and attempts by outcome, with database triggers.

The counts change in the transaction of each change. Therefore reading them takes the same time for any number of jobs.
Counters in the functions of the ledger would be wrong as soon as a new statement does not update them.
"""

from __future__ import annotations

from collections.abc import Iterator

from sqlalchemy import Table, delete, func, insert, select, text
from sqlalchemy.engine import Connection

from coordinator.ledger.tables import BUILD, attempt_tallies, attempts, job_tallies, jobs

_COUNT_JOBS = select(
    jobs.c.state, jobs.c.scene, jobs.c.tier, jobs.c.split, jobs.c.superseded, func.count().label("jobs")
).group_by(jobs.c.state, jobs.c.scene, jobs.c.tier, jobs.c.split, jobs.c.superseded)
_COUNT_ATTEMPTS = select(
    attempts.c.outcome, func.count().label("attempts"), func.sum(attempts.c.steps).label("steps")
).group_by(attempts.c.outcome)
JOB_COUNTS = select(job_tallies).where(job_tallies.c.tier != BUILD)
"""Query for the number of jobs by state, scene, tier, split and whether they are superseded, without builds of
layouts."""
ATTEMPT_COUNTS = select(attempt_tallies)
"""Query for the number of attempts and the sum of their steps, by outcome."""
_TALLIES = ((jobs, job_tallies, _COUNT_JOBS), (attempts, attempt_tallies, _COUNT_ATTEMPTS))


def install_tallies(connection: Connection) -> None:
    """Creates the triggers, and counts the rows that are in the ledger already; writes nothing if the counts are right.

    Args:
        connection: connection of the writer within a transaction; the ledger has all tables.
    """
    for counted, tally, count in _TALLIES:
        for statement in _triggers(connection.dialect.name, counted, tally):
            connection.execute(text(statement))
        known = {tuple(row) for row in connection.execute(select(tally).where(tally.c[counted.name] > 0))}
        if known != {tuple(row) for row in connection.execute(count)}:
            connection.execute(delete(tally))
            connection.execute(insert(tally).from_select([column.name for column in tally.c], count))


def build_counts(connection: Connection) -> dict[str, int]:
    """Returns the number of layouts that workers build, by state of the build; empty if there are none."""
    count = select(job_tallies.c.state, func.sum(job_tallies.c.jobs)).where(
        job_tallies.c.tier == BUILD, job_tallies.c.superseded.is_(False), job_tallies.c.jobs > 0
    )
    return {row[0]: int(row[1]) for row in connection.execute(count.group_by(job_tallies.c.state))}


def _triggers(dialect: str, counted: Table, tally: Table) -> Iterator[str]:
    """Yields the statements that create the triggers of a table.

    SQLite keeps an existing trigger of the same name, so a changed trigger needs a new name there.
    """
    add, subtract = _add(tally), _subtract(tally)
    if dialect == "postgresql":
        name = f"count_{counted.name}"
        yield (
            f"CREATE OR REPLACE FUNCTION {name}() RETURNS trigger LANGUAGE plpgsql AS $$ BEGIN "
            f"IF TG_OP = 'UPDATE' THEN {subtract}; END IF; {add}; RETURN NULL; END $$"
        )
        yield f"DROP TRIGGER IF EXISTS {name} ON {counted.name}"
        yield (
            f"CREATE TRIGGER {name} AFTER INSERT OR UPDATE OF {_watched(tally)} ON {counted.name} "
            f"FOR EACH ROW EXECUTE FUNCTION {name}()"
        )
        return
    for event, body in (("INSERT", f"{add};"), (f"UPDATE OF {_watched(tally)}", f"{subtract}; {add};")):
        name = f"count_{counted.name}_{event.split()[0].lower()}"
        yield f"CREATE TRIGGER IF NOT EXISTS {name} AFTER {event} ON {counted.name} BEGIN {body} END"


def _watched(tally: Table) -> str:
    """Returns the key columns of a tally, as SQL. The counted table has columns of the same names."""
    return ", ".join(column.name for column in tally.primary_key)


def _add(tally: Table) -> str:
    keys = _watched(tally)
    values = ", ".join(_amount(column.name, tally) for column in tally.c)
    sums = ", ".join(f"{name} = {tally.name}.{name} + excluded.{name}" for name in _sums(tally))
    return (
        f"INSERT INTO {tally.name} ({', '.join(tally.c.keys())}) VALUES ({values}) "
        f"ON CONFLICT ({keys}) DO UPDATE SET {sums}"
    )


def _subtract(tally: Table) -> str:
    sums = ", ".join(f"{name} = {name} - {_amount(name, tally, 'OLD')}" for name in _sums(tally))
    where = " AND ".join(f"{column.name} = OLD.{column.name}" for column in tally.primary_key)
    return f"UPDATE {tally.name} SET {sums} WHERE {where}"


def _amount(name: str, tally: Table, row: str = "NEW") -> str:
    """Returns, as SQL, what a row of the counted table adds to the column `name` of a tally.

    A row adds 1 to the number of rows, and its own value to a sum such as `steps`.
    """
    return "1" if name == tally.name.replace("_tallies", "s") else f"{row}.{name}"


def _sums(tally: Table) -> list[str]:
    return [column.name for column in tally.c if not column.primary_key]
