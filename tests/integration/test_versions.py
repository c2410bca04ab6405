"""Mixed versions: other sources and other protocols are refused with both versions, and a run records its versions."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
from structlog.testing import capture_logs

from coordinator.ledger.database.engine import sqlite_url
from coordinator.ledger.opening import note_version, recorded_versions
from coordinator.options import CoordinatorOptions
from coordinator.protocol.relay import JoinReply
from coordinator.service import Coordinator
from coordinator.settings import CoordinatorSettings
from schemas.protocol.keys import Verb
from schemas.protocol.messages import PROTOCOL, HelloReply, Refusal
from schemas.support.product import product_version, why_refused
from tests.builders.ledger import room_catalog, room_plan
from tests.builders.shared_validator import SharedValidator
from tests.builders.wire_worker import WireWorker

ROOT = Path(__file__).parents[2]
PACKAGES = ("coordinator", "factory", "minivla", "schemas", "workers")
VERSION = product_version()


@pytest.fixture
def options(checker: SharedValidator) -> CoordinatorOptions:
    settings = CoordinatorSettings.model_validate({"reserve_bytes": 0, "pullers": 1})
    return CoordinatorOptions(listen=("tcp/127.0.0.1:0",), settings=settings, checker=checker)


@pytest.fixture
def opened(tmp_path: Path, options: CoordinatorOptions) -> Iterator[Coordinator]:
    with Coordinator(tmp_path / "out", room_plan(2), room_catalog(tmp_path), options) as running:
        yield running


def edited_copy(folder: Path, module: str) -> Path:
    """Copies the packages to a folder and appends a comment to one module."""
    for package in PACKAGES:
        shutil.copytree(ROOT / package, folder / package, ignore=shutil.ignore_patterns("__pycache__", "static"))
    with (folder / module).open("a") as file:
        file.write("# edited\n")
    return folder


def factory_of(source: Path, *words: str) -> subprocess.CompletedProcess[str]:
    """Runs `factory` of a source folder."""
    environment = {**os.environ, "PYTHONPATH": str(source), "MINIVLA_CACHE": str(source / "cache")}
    command = [sys.executable, "-m", "factory", *words]
    return subprocess.run(command, capture_output=True, text=True, env=environment, cwd=source, timeout=120)


def test_a_worker_of_an_edited_source_is_refused_and_the_message_names_both_versions(opened, tmp_path):
    source = edited_copy(tmp_path / "other", "workers/sim/spawn.py")
    other = factory_of(source, "--version").stdout.split()[-1]
    assert other != VERSION
    assert other.partition("+")[0] == VERSION.partition("+")[0]
    ended = factory_of(source, "worker", "--connect", opened.endpoints[0], "--connect-timeout", "60")
    assert ended.returncode == 1
    assert other in ended.stderr
    assert VERSION in ended.stderr
    assert "the source differs" in ended.stderr
    assert opened.progress().workers == ()


def test_registrations_of_another_protocol_are_refused_with_the_older_side(opened):
    with WireWorker(opened.endpoints, opened.run) as worker:
        hello = {"sid": worker.sid, "host": worker.host, "slots": 1, "version": "0.1.0"}
        join = {"version": "9.0.0", "router": "1f", "protocol": PROTOCOL + 1, "unknown": [1, 2]}
        older = worker.ask(Verb.HELLO, json.dumps(hello).encode(), HelloReply)
        newer = worker.ask(Verb.JOIN, json.dumps(join).encode(), JoinReply)
    assert isinstance(older, Refusal)
    assert f"runs minivla-factory 0.1.0, the coordinator {VERSION}, with protocol 1 and {PROTOCOL}" in older.error
    assert f"the worker is older: install {VERSION} for the worker" in older.error
    assert isinstance(newer, Refusal)
    assert "the coordinator is older" in newer.error
    assert "install 9.0.0 there" in newer.error
    assert opened.progress().workers == ()


def test_a_message_of_no_protocol_is_refused_as_invalid(opened):
    with WireWorker(opened.endpoints, opened.run) as worker:
        nested = b'{"protocol": ' + b"[" * 2000
        wrong = json.dumps({"sid": worker.sid, "host": worker.host, "protocol": "x"}).encode()
        for payload in (b"", b"[]", wrong, nested):
            reply = worker.ask(Verb.HELLO, payload, HelloReply)
            assert isinstance(reply, Refusal)
            assert "invalid message" in reply.error


@pytest.mark.parametrize(
    ("theirs", "mine", "expected"),
    [
        ("0.1.9+aaaaaaaaaa", "0.2.0+bbbbbbbbbb", "the worker is older"),
        ("0.10.0+aaaaaaaaaa", "0.9.0+bbbbbbbbbb", "the coordinator is older"),
        ("0.2.0+aaaaaaaaaa", "0.2.0+bbbbbbbbbb", "the source differs"),
        ("", "0.2.0+bbbbbbbbbb", "of unknown version"),
    ],
)
def test_the_older_release_is_named(theirs, mine, expected):
    assert expected in why_refused("worker host.1", theirs, 2, mine=mine, my_protocol=2)


def test_a_run_that_another_version_continues_is_reported_and_recorded(tmp_path, options):
    root, plan, catalog = tmp_path / "out", room_plan(2), room_catalog(tmp_path)
    with Coordinator(root, plan, catalog, options) as opened, capture_logs() as quiet:
        assert opened.progress().versions == (VERSION,)
        opened._run.ledger.writer.call(lambda connection: note_version(connection, "0.1.0+0123456789"))
    with capture_logs() as logs, Coordinator(root, plan, catalog, options) as opened:
        assert opened.progress().versions == (VERSION, "0.1.0+0123456789", VERSION)
    changed = [entry for entry in logs if entry["event"] == "version_changed"]
    assert [(entry["run_by"], entry["now"], entry["log_level"]) for entry in changed] == [
        ("0.1.0+0123456789", VERSION, "warning")
    ]
    with capture_logs() as again, Coordinator(root, plan, catalog, options):
        pass
    assert not [entry for entry in (*quiet, *again) if entry["event"] == "version_changed"]


def test_a_ledger_without_recorded_versions_stays_readable(tmp_path, options):
    from sqlalchemy import create_engine, text

    root, plan, catalog = tmp_path / "out", room_plan(2), room_catalog(tmp_path)
    with Coordinator(root, plan, catalog, options):
        pass
    engine = create_engine(sqlite_url(root / "ledger.db"))
    with engine.begin() as connection:
        connection.execute(text("DELETE FROM info WHERE key = 'versions'"))
        assert recorded_versions(connection) == ()
    engine.dispose()
    with capture_logs() as logs, Coordinator(root, plan, catalog, options) as opened:
        assert opened.progress().versions == (VERSION,)
    assert "version_changed" not in [entry["event"] for entry in logs]
