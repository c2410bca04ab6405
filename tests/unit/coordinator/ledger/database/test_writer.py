"""The writer thread: group commits, isolation of failing requests, answers after COMMIT."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from pathlib import Path

import pytest
from sqlalchemy import Connection, Engine, insert, select

from coordinator.ledger.database.engine import open_writer, sqlite_url
from coordinator.ledger.database.writer import Writer
from coordinator.ledger.tables import METADATA, info
from schemas.errors import TransientError


@pytest.fixture
def engine(tmp_path: Path) -> Iterator[Engine]:
    engine = open_writer(sqlite_url(tmp_path / "ledger.db"))
    METADATA.create_all(engine)
    yield engine
    engine.dispose()


def put(key: str, poison: Exception | None = None):
    def work(connection: Connection) -> str:
        connection.execute(insert(info).values(key=key, value="x"))
        if poison:
            raise poison
        return key

    return work


def keys(engine: Engine) -> list[str]:
    with engine.connect() as connection:
        return list(connection.execute(select(info.c.key).order_by(info.c.key)).scalars())


def held_back(writer: Writer) -> threading.Event:
    """Keeps the writer busy until the event is set, so later requests share one commit."""
    gate = threading.Event()
    writer.submit(lambda _: gate.wait(60))
    return gate


def test_a_failing_request_does_not_affect_the_other_requests_of_its_group_commit(engine):
    with Writer(engine) as writer:
        gate = held_back(writer)
        futures = [writer.submit(work) for work in (put("a"), put("b", ValueError("poison")), put("c"), put("a"))]
        gate.set()
        assert futures[0].result(10) == "a"
        assert isinstance(futures[1].exception(10), ValueError)
        assert futures[2].result(10) == "c"
        assert isinstance(futures[3].exception(10), TransientError)
    assert keys(engine) == ["a", "c"]


def test_an_answer_is_sent_after_its_commit(engine):
    seen = threading.Event()
    found: list[str] = []

    def look(_: object) -> None:
        found.extend(keys(engine))
        seen.set()

    with Writer(engine) as writer:
        writer.submit(put("a")).add_done_callback(look)
        assert seen.wait(60)
    assert found == ["a"]


def test_a_slow_answer_does_not_delay_the_next_commit(engine):
    answering, gate, ran = threading.Event(), threading.Event(), threading.Event()

    def answer(_: object) -> None:
        answering.set()
        gate.wait(60)

    with Writer(engine) as writer:
        held = held_back(writer)
        writer.submit(put("a")).add_done_callback(answer)
        held.set()
        assert answering.wait(60)
        later = writer.submit(lambda connection: ran.set() or put("b")(connection))
        assert ran.wait(60)
        assert not later.done(), "answers are given in the order of the commits"
        gate.set()
        assert later.result(60) == "b"
    assert keys(engine) == ["a", "b"]


def test_many_threads_share_one_writer(engine):
    with Writer(engine) as writer:
        threads = [
            threading.Thread(target=lambda n=n: [writer.call(put(f"{n}-{i}")) for i in range(20)]) for n in range(8)
        ]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
    assert len(keys(engine)) == 160


def test_closing_commits_what_is_queued_and_refuses_what_follows(engine):
    writer = Writer(engine)
    futures = [writer.submit(put(str(n))) for n in range(600)]
    writer.close()
    assert all(future.result(0) for future in futures)
    assert len(keys(engine)) == 600
    with pytest.raises(TransientError, match="closed"):
        writer.call(put("late"))
    writer.close()


def test_a_failed_commit_raises_a_transient_error_and_later_requests_succeed(engine, tmp_path):
    with Writer(engine) as writer:
        writer.call(lambda connection: connection.exec_driver_sql("PRAGMA max_page_count=1") and None)
        big = put("big")

        def overflow(connection: Connection) -> str:
            connection.execute(insert(info).values(key="filler", value="x" * 1_000_000))
            return big(connection)

        with pytest.raises(TransientError, match="full"):
            writer.call(overflow)
        writer.call(lambda connection: connection.exec_driver_sql("PRAGMA max_page_count=1000000") and None)
        assert writer.call(put("small")) == "small"
    assert keys(engine) == ["small"]
