"""A complete run on a PostgreSQL ledger: single writer, rebuild, read-only readers, error messages."""

from __future__ import annotations

from datetime import UTC, datetime
from pathlib import Path

import pytest
from sqlalchemy import text
from sqlalchemy.exc import DatabaseError

from coordinator.ledger.database.engine import open_reader, open_writer
from coordinator.ledger.reading.audit import ledger_trouble
from coordinator.ledger.reading.records import LedgerEpisodes
from coordinator.options import CoordinatorOptions
from coordinator.recovery.repair_dataset import RepairInput, repair
from coordinator.service import Coordinator
from coordinator.settings import CoordinatorSettings
from coordinator.validation.validator import Validator
from factory.dataset.site import site_of
from factory.runs.ledger import progress_of
from schemas.errors import UsageError, WorldError
from schemas.support.product import product_version
from tests.builders.ledger import room_catalog, room_plan
from tests.builders.ports import free_endpoint
from tests.builders.postgres import Postgres
from tests.builders.shared_validator import SharedValidator
from tests.builders.wire_worker import WireWorker, bundle_for, until

SETTINGS = CoordinatorSettings(reserve_bytes=0, retry_after_s=0.1, pullers=1, pull_timeout_s=1.0)
ANY_PORT = ("tcp/127.0.0.1:0",)


@pytest.fixture
def url(postgres_server: Postgres) -> str:
    return postgres_server.new_database()


@pytest.fixture
def finished(tmp_path: Path, url: str, checker: SharedValidator) -> RepairInput:
    """A finished run of two episodes."""
    plan, catalog = room_plan(2), room_catalog(tmp_path)
    options = CoordinatorOptions(listen=ANY_PORT, ledger_url=url, settings=SETTINGS, checker=checker)
    with (
        Coordinator(tmp_path / "out", plan, catalog, options) as hub,
        WireWorker(hub.endpoints, hub.run) as worker,
    ):
        worker.hello(product_version())
        for _ in range(2):
            job, lease = worker.job()
            assert worker.deliver(lease, bundle_for(job))
        until(hub.is_finished)
    return RepairInput(tmp_path / "out", tmp_path / "out", url, plan, catalog, {})


def test_a_run_on_a_server_leaves_no_ledger_in_the_directory_and_resumes(finished):
    assert not (finished.root / "ledger.db").exists()
    with Coordinator(
        finished.root,
        finished.plan,
        finished.catalog,
        CoordinatorOptions(listen=ANY_PORT, ledger_url=finished.url, settings=SETTINGS),
    ) as again:
        assert again.is_finished()
        assert again.progress().jobs["archived"] == 2


def test_a_second_coordinator_is_refused_even_from_another_directory(finished, tmp_path):
    with (
        Coordinator(
            finished.root,
            finished.plan,
            finished.catalog,
            CoordinatorOptions(listen=ANY_PORT, ledger_url=finished.url, settings=SETTINGS),
        ),
        pytest.raises(WorldError, match="is in use by another coordinator"),
    ):
        Coordinator(
            tmp_path / "elsewhere",
            finished.plan,
            finished.catalog,
            CoordinatorOptions(listen=ANY_PORT, ledger_url=finished.url, settings=SETTINGS),
        )


def test_a_reader_cannot_write(finished):
    reader = open_reader(finished.url)
    with reader.connect() as connection:
        assert len(list(LedgerEpisodes(connection).rows(1, 2))) == 2
    with reader.connect() as connection, pytest.raises(DatabaseError, match="read-only"):
        connection.execute(text("delete from episodes"))
    reader.dispose()


def test_status_shows_no_worker_alive_once_the_coordinator_has_ended(finished):
    site = site_of(str(finished.root))
    assert [worker.alive for worker in progress_of(site, finished.url).workers] == [False]
    with (
        Coordinator(
            finished.root,
            finished.plan,
            finished.catalog,
            CoordinatorOptions(listen=ANY_PORT, ledger_url=finished.url, settings=SETTINGS),
        ) as hub,
        WireWorker(hub.endpoints, hub.run, "live") as worker,
    ):
        worker.beat()
        assert worker.sid in {one.sid for one in progress_of(site, finished.url).workers if one.alive}
    assert not any(worker.alive for worker in progress_of(site, finished.url).workers)


def test_an_emptied_database_is_rebuilt_from_plan_and_archive(finished, postgres_server):
    empty = postgres_server.new_database()
    assert "lacks the tables" in ledger_trouble(empty)
    moved = RepairInput(finished.root, finished.root, empty, finished.plan, finished.catalog, {})
    with Validator() as validator:
        report = repair(moved, validator, datetime.now(UTC), apply=True)
        assert [str(action.kind) for action in report.actions] == ["rebuild", "adopt", "adopt"]
        assert repair(moved, validator, datetime.now(UTC), apply=False).is_sound


def test_a_writer_survives_a_lost_connection(url, postgres_server):
    engine = open_writer(url)
    with engine.connect() as connection:
        (own,) = connection.execute(text("select pg_backend_pid()")).one()
    other = open_reader(postgres_server.url("postgres"))
    with other.connect() as connection:
        connection.execute(text("select pg_terminate_backend(:pid)"), {"pid": own})
    other.dispose()
    with engine.connect() as connection:
        (now,) = connection.execute(text("select pg_backend_pid()")).one()
    engine.dispose()
    assert now != own


def test_an_unreachable_server_is_named_without_the_password():
    endpoint = free_endpoint().removeprefix("tcp/")
    pytest.importorskip("psycopg")
    for opening in (open_writer, open_reader):
        with pytest.raises(WorldError, match="cannot be reached") as caught:
            opening(f"postgresql+psycopg://me:secret@{endpoint}/run")
        assert "secret" not in str(caught.value)


def test_a_missing_driver_is_named_with_the_remedy():
    with pytest.raises(UsageError, match=r"pip install 'psycopg\[binary\]'"):
        open_writer("postgresql+psycopg2://me:secret@localhost/run")  # a driver that is not installed
