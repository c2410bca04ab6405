"""Prepared statements compared with SQLAlchemy's own: the same rows, the same transactions, the same exceptions."""

from __future__ import annotations

from collections.abc import Iterator

import pytest
from sqlalchemy import Connection, Engine, bindparam, insert, select, text, update
from sqlalchemy.exc import IntegrityError, ProgrammingError

from coordinator.ledger.database.engine import open_reader, open_writer
from coordinator.ledger.database.prepared import PreparedStatement
from coordinator.ledger.database.writer import Writer
from coordinator.ledger.states import JobState
from coordinator.ledger.tables import METADATA, events, jobs, workers
from coordinator.ledger.transitions import JOB

HIRE = PreparedStatement(insert(workers))
SLOTS = PreparedStatement(select(workers.c.slots, workers.c.host).where(workers.c.sid == bindparam("by")))
GROW = PreparedStatement(update(workers).where(workers.c.host == bindparam("at")).values(slots=workers.c.slots + 1))
NOTE = PreparedStatement(insert(events))


@pytest.fixture(params=["sqlite", "postgresql"])
def url(request: pytest.FixtureRequest, tmp_path) -> str:
    if request.param == "sqlite":
        return f"sqlite:///{tmp_path / 'ledger.db'}"
    return request.getfixturevalue("postgres_server").new_database()


@pytest.fixture
def engine(url: str) -> Iterator[Engine]:
    engine = open_writer(url)
    METADATA.create_all(engine)
    yield engine
    engine.dispose()


def hire(connection: Connection, sid: str, host: str = "a") -> int:
    worker = {"sid": sid, "host": host, "slots": 1, "version": "", "archived": 0, "last_beat": 1.5}
    return HIRE.count(connection, worker)


def test_columns_of_a_row_are_attributes_and_changed_rows_are_counted(engine):
    with engine.begin() as connection:
        assert [hire(connection, "a.1"), hire(connection, "a.2"), hire(connection, "b.1", "b")] == [1, 1, 1]
        assert GROW.count(connection, {"at": "a"}) == 2
        found = SLOTS.first(connection, {"by": "a.2"})
        assert found is not None
        assert (found.slots, found.host) == (2, "a")
        assert SLOTS.first(connection, {"by": "nobody"}) is None


def test_a_row_equals_the_row_that_sqlalchemy_returns(engine):
    with engine.begin() as connection:
        row = {"idx": 7, "draw": 0, "scene": "s", "tier": "near", "split": "train", "category": "c", "target_id": "t"}
        row |= {"colour": "red", "template_id": "x", "instruction": "Go.", "state": JobState.PENDING, "size": 1 << 40}
        connection.execute(insert(jobs), row)
        query = select(*JOB).where(jobs.c.state == JobState.PENDING)
        assert PreparedStatement(query).first(connection, {}) == tuple(connection.execute(query).one())


def test_the_database_assigns_autoincremented_keys(engine):
    with engine.begin() as connection:
        line = {"at": 1.0, "job_id": 3, "event": "claimed", "state": "leased", "attempt": 1, "fence": 1, "sid": ""}
        for _ in range(2):
            NOTE.count(connection, {**line, "detail": ""})
        assert list(connection.execute(select(events.c.id).order_by(events.c.id)).scalars()) == [1, 2]


def test_the_rollback_of_a_transaction_or_savepoint_removes_only_its_rows(engine):
    with engine.begin() as connection:
        hire(connection, "a.1")
        savepoint = connection.begin_nested()
        hire(connection, "a.2")
        savepoint.rollback()
    with engine.connect() as connection:  # a transaction starts implicitly, as with SQLAlchemy's statements
        hire(connection, "a.3")
        connection.rollback()
    with engine.begin() as connection:
        assert list(connection.execute(select(workers.c.sid)).scalars()) == ["a.1"]


def test_database_errors_are_raised_as_sqlalchemy_errors(engine):
    with engine.begin() as connection:
        hire(connection, "a.1")
    with engine.connect() as connection, pytest.raises(IntegrityError, match="INSERT INTO workers"):
        hire(connection, "a.1")


def test_a_missing_parameter_is_named(engine):
    with engine.begin() as connection, pytest.raises((KeyError, ProgrammingError), match="by"):
        SLOTS.first(connection, {})


def test_a_statement_that_returns_a_boolean_column_is_refused():
    with pytest.raises(TypeError, match="must not return Boolean columns; requested: id, superseded"):
        PreparedStatement(select(jobs.c.id, jobs.c.superseded))


def test_a_lost_connection_is_replaced_by_the_writer(postgres_server):
    url = postgres_server.new_database()
    engine = open_writer(url)
    METADATA.create_all(engine)
    with Writer(engine) as writer:
        assert writer.call(lambda connection: hire(connection, "a.1")) == 1
        own = writer.call(lambda connection: connection.execute(text("select pg_backend_pid()")).scalar_one())
        other = open_reader(postgres_server.url("postgres"))
        with other.connect() as connection:
            connection.execute(text("select pg_terminate_backend(:pid, 60000)"), {"pid": own})
        other.dispose()
        assert writer.call(lambda connection: hire(connection, "a.2")) == 1
    with engine.connect() as connection:
        assert list(connection.execute(select(workers.c.sid).order_by(workers.c.sid)).scalars()) == ["a.1", "a.2"]
    engine.dispose()
