"""A complete run on a PostgreSQL ledger: single writer, rebuild, read-only readers, error messages."""

from __future__ import annotations

import json
import re
from datetime import UTC, datetime
from pathlib import Path

import pytest
from click.testing import CliRunner
from sqlalchemy import text
from sqlalchemy.exc import DatabaseError

from coordinator.ledger.database.engine import open_reader, open_writer
from coordinator.ledger.opening import record_ledger, recorded_ledger
from coordinator.ledger.reading.audit import ledger_trouble
from coordinator.ledger.reading.records import LedgerEpisodes
from coordinator.options import CoordinatorOptions
from coordinator.recovery.repair_dataset import RepairInput, repair
from coordinator.service import Coordinator
from coordinator.settings import CoordinatorSettings
from coordinator.validation.validator import Validator
from factory.cli.main import cli
from factory.dataset.site import site_of
from factory.runs.ledger import progress_of
from schemas.errors import UsageError, WorldError
from schemas.support.product import product_version
from tests.builders.ledger import room_catalog, room_plan
from tests.builders.ports import free_endpoint
from tests.builders.postgres import Postgres, postgres
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


def test_a_coordinator_survives_an_outage_of_the_server_and_ends_after_a_long_one(tmp_path, checker):
    plan, catalog = room_plan(2), room_catalog(tmp_path)
    with postgres() as server:
        settings = SETTINGS.model_copy(update={"ledger_outage_s": 8.0, "lease_ttl_s": 60.0})
        options = CoordinatorOptions(
            listen=ANY_PORT, ledger_url=server.new_database(), settings=settings, checker=checker
        )
        with (
            Coordinator(tmp_path / "out", plan, catalog, options) as hub,
            WireWorker(hub.endpoints, hub.run) as worker,
        ):
            worker.hello(product_version())
            job, lease = worker.job()
            before = hub.progress()
            server.stop()
            assert not hub.wait(timeout_s=4.0)
            assert hub.progress() == before
            server.start()
            until(lambda: worker.deliver(lease, bundle_for(job)))
            until(lambda: hub.progress().jobs["archived"] == 1)
            job, lease = worker.job()
            server.stop()
            with pytest.raises(WorldError, match="has not answered for") as caught:
                hub.wait(timeout_s=60.0)
            server.start()
            until(lambda: worker.deliver(lease, bundle_for(job)))
            until(hub.is_finished)
    assert "factory repair" not in str(caught.value)
    assert "same command" in str(caught.value)


def test_the_dataset_names_its_ledger_without_password_and_no_second_one_is_made(finished, monkeypatch):
    record = json.loads((finished.root / "ledger.json").read_text())
    assert record == {"kind": "postgresql", "url": finished.url}
    site = site_of(str(finished.root))
    for reading in (lambda: progress_of(site), lambda: Coordinator(finished.root, finished.plan, finished.catalog)):
        with pytest.raises(UsageError, match="MINIVLA_LEDGER") as caught:
            reading()
        assert finished.url in str(caught.value)
    for words in (["status"], ["repair"], ["jobs", "list"], ["jobs", "pause"]):
        ended = CliRunner().invoke(cli, [*words, str(finished.root)])
        assert isinstance(ended.exception, UsageError), words
        assert "second ledger" in str(ended.exception)
    assert not (finished.root / "ledger.db").exists()
    monkeypatch.setenv("MINIVLA_LEDGER", finished.url)
    assert CliRunner().invoke(cli, ["status", str(finished.root)]).exit_code == 0


def test_the_record_of_the_ledger_hides_secrets_and_a_damaged_one_is_refused(tmp_path):
    record_ledger(tmp_path, "postgresql+psycopg://me:secret@db/run?sslpassword=hidden")
    assert recorded_ledger(tmp_path) == "postgresql+psycopg://me@db/run"
    assert not {"secret", "hidden"} & set(re.findall("[a-z]+", (tmp_path / "ledger.json").read_text()))
    record_ledger(tmp_path, f"sqlite:///{tmp_path / 'ledger.db'}")
    assert recorded_ledger(tmp_path) == ""
    for damage in ("", "[]", '{"kind": "oracle", "url": "x"}', "{" * 100_000):
        (tmp_path / "ledger.json").write_text(damage)
        with pytest.raises(WorldError, match="is damaged"):
            recorded_ledger(tmp_path)
