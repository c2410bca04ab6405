"""`/healthz`, `/readyz` and `/metrics` of a real coordinator, asked over a real socket."""

from __future__ import annotations

import contextlib
import http.client
import socket
import threading
from collections.abc import Iterator
from importlib.metadata import version
from pathlib import Path

import pytest
from prometheus_client.parser import text_string_to_metric_families

from coordinator.http import HttpAddress, StatusServer, parse_address
from coordinator.service import Coordinator
from coordinator.settings import CoordinatorSettings
from schemas.errors import UsageError, WorldError
from schemas.terms import FailReason
from tests.builders.ledger import room_catalog, room_plan
from tests.builders.wire_worker import WireWorker, bundle_for, until

LOOPBACK = HttpAddress("127.0.0.1", 0)
TOKEN = "0123456789abcdef"


@pytest.fixture
def opened(tmp_path: Path) -> Iterator[Coordinator]:
    settings = CoordinatorSettings(reserve_bytes=0, retry_after_s=0.1, pullers=1, pull_timeout_s=1.0)
    endpoint = ("tcp/127.0.0.1:0",)
    with Coordinator(tmp_path / "out", room_plan(2), room_catalog(tmp_path), endpoint, settings=settings) as running:
        yield running


@pytest.fixture
def server(opened: Coordinator) -> Iterator[StatusServer]:
    with StatusServer(LOOPBACK, opened.vitals) as serving:
        yield serving


def ask(server: StatusServer, path: str, method: str = "GET", **headers: str) -> tuple[int, str]:
    connection = http.client.HTTPConnection(server.url.removeprefix("http://"), timeout=10)
    connection.request(method, path, headers=headers)
    reply = connection.getresponse()
    return reply.status, reply.read().decode()


def figures(page: str) -> dict[tuple[str, str], float]:
    """Returns (name, label values) -> value."""
    return {
        (sample.name, ",".join(sample.labels.values())): sample.value
        for family in text_string_to_metric_families(page)
        for sample in family.samples
    }


def test_a_running_coordinator_is_healthy_and_ready(server):
    assert ask(server, "/healthz") == (200, "ok\n")
    assert ask(server, "/readyz") == (200, "ready\n")
    assert ask(server, "/healthz", "HEAD") == (200, "")


def test_figures_follow_the_run(opened, server):
    with WireWorker(opened.endpoints, opened.run) as worker:
        worker.hello(version("minivla-factory"))
        job, lease = worker.job()
        assert worker.fail(lease, FailReason.TIMEOUT)
        job, lease = worker.job()
        bundle = bundle_for(job)
        assert worker.deliver(lease, bundle)
        until(lambda: opened.progress().jobs["archived"] == 1)
        until(lambda: figures(ask(server, "/metrics")[1])[("minivla_episodes", "")] == 1, 5)
        found = figures(ask(server, "/metrics")[1])
    assert found[("minivla_jobs", "archived")] == found[("minivla_jobs", "pending")] == 1
    assert found[("minivla_scene_jobs", "room,archived")] == 1
    assert found[("minivla_frames", "")] == 12
    assert found[("minivla_attempts", "timeout")] == found[("minivla_attempts", "success")] == 1
    assert found[("minivla_workers_alive", "")] == 1
    assert found[("minivla_slots_alive", "")] == 2
    assert found[("minivla_claims_total", "")] == 2
    assert found[("minivla_requests_total", "done")] == 1
    assert found[("minivla_pull_bytes_total", "")] == len(bundle)
    assert found[("minivla_validation_seconds_count", "")] == 1
    assert found[("minivla_validation_seconds_sum", "")] > 0
    assert found[("minivla_disk_free_bytes", "")] > 0
    assert found[("minivla_bundles_refused_total", "")] == found[("minivla_lease_expiries_total", "")] == 0


def test_a_closed_coordinator_is_neither_healthy_nor_ready(tmp_path):
    coordinator = Coordinator(tmp_path / "out", room_plan(1), room_catalog(tmp_path), ("tcp/127.0.0.1:0",))
    with StatusServer(LOOPBACK, coordinator.vitals) as server:
        coordinator.close()
        assert ask(server, "/healthz")[0] == 503
        status, text = ask(server, "/readyz")
    assert status == 503
    assert "not listening" in text
    assert "ledger is closed" in text


@pytest.mark.parametrize(
    ("method", "path", "status"), [("GET", "/nothing", 404), ("POST", "/metrics", 501), ("GET", "/metrics/../", 404)]
)
def test_anything_else_is_refused(server, method, path, status):
    assert ask(server, path, method)[0] == status


def test_figures_behind_a_token_are_shown_to_its_owner_only_and_health_to_everybody(opened):
    with StatusServer(LOOPBACK, opened.vitals, TOKEN) as server:
        assert ask(server, "/metrics")[0] == 401
        assert ask(server, "/metrics?token=x")[0] == 401
        assert ask(server, "/metrics", Authorization="Bearer 0123456789abcdeF")[0] == 401
        assert ask(server, "/metrics", Authorization=f"Bearer {TOKEN}")[0] == 200
        assert ask(server, "/healthz")[0] == ask(server, "/readyz")[0] == 200


def test_silent_and_endless_clients_do_not_keep_others_out(server):
    address = server.url.removeprefix("http://").split(":")
    silent = [socket.create_connection((address[0], int(address[1]))) for _ in range(8)]
    endless = socket.create_connection((address[0], int(address[1])))
    endless.sendall(b"GET /" + b"a" * 70_000)
    assert ask(server, "/healthz") == (200, "ok\n")
    with contextlib.suppress(ConnectionResetError):  # it was cut off with bytes unread
        assert not endless.recv(100).startswith(b"HTTP/1.1 200")
    for client in (*silent, endless):
        client.close()


def test_many_who_ask_at_once_are_all_answered_or_turned_away(server):
    answers: list[int] = []

    def once() -> None:
        try:
            answers.append(ask(server, "/metrics")[0])
        except (OSError, http.client.HTTPException):
            answers.append(0)

    threads = [threading.Thread(target=once) for _ in range(40)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert len(answers) == 40
    assert set(answers) <= {0, 200}
    assert ask(server, "/healthz")[0] == 200


def test_a_taken_address_is_named(opened, server):
    port = int(server.url.rpartition(":")[2])
    with pytest.raises(WorldError, match=f"127.0.0.1:{port}"):
        StatusServer(HttpAddress("127.0.0.1", port), opened.vitals)


@pytest.mark.parametrize("text", ["127.0.0.1:9464", "localhost:0", "[::1]:80"])
def test_loopback_needs_no_token(text):
    assert parse_address(text, None).port == int(text.rpartition(":")[2])


@pytest.mark.parametrize("text", ["0.0.0.0:9464", ":9464", "10.0.0.1:9464", "example.org:80"])
def test_other_addresses_need_a_token_that_cannot_be_guessed(text):
    with pytest.raises(UsageError, match="--http-token"):
        parse_address(text, None)
    with pytest.raises(UsageError, match="at least 16"):
        parse_address(text, "short")
    parse_address(text, TOKEN)


@pytest.mark.parametrize("text", ["9464", "localhost", "h:99999", "h:x"])
def test_a_malformed_address_is_refused(text):
    with pytest.raises(UsageError, match="HOST:PORT"):
        parse_address(text, TOKEN)
