"""`/healthz`, `/readyz` and `/metrics` of a real coordinator over a real socket."""

from __future__ import annotations

import contextlib
import http.client
import socket
import threading
import time
from collections.abc import Iterator
from pathlib import Path

import pytest
from prometheus_client.parser import text_string_to_metric_families

from coordinator.options import CoordinatorOptions
from coordinator.service import Coordinator
from coordinator.settings import CoordinatorSettings
from coordinator.status.address import HttpAddress, is_own_name, parse_address
from coordinator.status.server import StatusServer
from factory.dataset.site import site_of
from factory.runs.ledger import progress_of
from schemas.errors import UsageError, WorldError
from schemas.support.product import product_version
from schemas.terms import FailReason
from tests.builders.ledger import room_catalog, room_plan
from tests.builders.wire_worker import WireWorker, bundle_for, until

LOOPBACK = HttpAddress("127.0.0.1", 0)
TOKEN = "0123456789abcdef"


@pytest.fixture
def opened(tmp_path: Path) -> Iterator[Coordinator]:
    settings = CoordinatorSettings(reserve_bytes=0, retry_after_s=0.1, pullers=1, pull_timeout_s=1.0)
    endpoint = ("tcp/127.0.0.1:0",)
    with Coordinator(
        tmp_path / "out", room_plan(2), room_catalog(tmp_path), CoordinatorOptions(listen=endpoint, settings=settings)
    ) as running:
        yield running


@pytest.fixture
def server(opened: Coordinator) -> Iterator[StatusServer]:
    with StatusServer(LOOPBACK, opened.health) as serving:
        yield serving


def ask(server: StatusServer, path: str, method: str = "GET", **headers: str) -> tuple[int, str]:
    connection = http.client.HTTPConnection(server.url.removeprefix("http://"), timeout=60)
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


def test_status_and_metrics_show_the_validator_sandbox_after_the_first_bundle(opened, server, tmp_path):
    assert opened.progress().sandbox == ()
    assert not any(name == "minivla_validator_sandbox" for name, _ in figures(ask(server, "/metrics")[1]))
    with WireWorker(opened.endpoints, opened.run) as worker:
        job, lease = worker.job()
        assert worker.deliver(lease, bundle_for(job))
        until(lambda: opened.progress().sandbox != ())
    layers = opened.progress().sandbox
    assert layers[0] == "rlimits"
    until(lambda: ("minivla_validator_sandbox", "rlimits") in figures(ask(server, "/metrics")[1]))
    found = figures(ask(server, "/metrics")[1])
    assert found["minivla_validator_sandbox", "rlimits"] == 1
    assert found["minivla_validator_sandbox", "seccomp"] == int("seccomp" in layers)
    assert progress_of(site_of(str(tmp_path / "out"))).sandbox == layers


def test_a_running_coordinator_is_healthy_and_ready(server):
    assert ask(server, "/healthz") == (200, "ok\n")
    assert ask(server, "/readyz") == (200, "ready\n")
    assert ask(server, "/healthz", "HEAD") == (200, "")


def test_metrics_follow_the_run(opened, server):
    with WireWorker(opened.endpoints, opened.run) as worker:
        worker.hello(product_version())
        job, lease = worker.job()
        assert worker.fail(lease, FailReason.TIMEOUT)
        job, lease = worker.job()
        bundle = bundle_for(job)
        assert worker.deliver(lease, bundle)
        until(lambda: opened.progress().jobs["archived"] == 1)
        until(lambda: figures(ask(server, "/metrics")[1])[("minivla_episodes", "")] == 1)
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
    coordinator = Coordinator(
        tmp_path / "out", room_plan(1), room_catalog(tmp_path), CoordinatorOptions(listen=("tcp/127.0.0.1:0",))
    )
    with StatusServer(LOOPBACK, coordinator.health) as server:
        coordinator.close()
        assert ask(server, "/healthz")[0] == 503
        status, text = ask(server, "/readyz")
    assert status == 503
    assert "not listening" in text
    assert "ledger is closed" in text


@pytest.mark.parametrize(
    ("method", "path", "status"), [("GET", "/nothing", 404), ("POST", "/metrics", 405), ("GET", "/metrics/../", 404)]
)
def test_other_requests_are_refused(server, method, path, status):
    assert ask(server, path, method)[0] == status


def test_metrics_require_the_token_and_health_does_not(opened):
    with StatusServer(LOOPBACK, opened.health, TOKEN) as server:
        assert ask(server, "/metrics")[0] == 401
        assert ask(server, "/metrics?token=x")[0] == 401
        assert ask(server, "/metrics", Authorization="Bearer 0123456789abcdeF")[0] == 401
        assert ask(server, "/metrics", Authorization=f"Bearer {TOKEN}")[0] == 200
        assert ask(server, "/healthz")[0] == ask(server, "/readyz")[0] == 200


def connected(server: StatusServer) -> socket.socket:
    host, port = server.url.removeprefix("http://").split(":")
    return socket.create_connection((host, int(port)), timeout=30)


def drip(client: socket.socket, text: bytes, most: int) -> int:
    """Sends a byte every 0.25 s, at most `most`, until the server closes the connection; returns the number sent."""
    client.settimeout(0.25)
    for sent in range(most):
        try:
            client.sendall(text[sent : sent + 1])
            if client.recv(1000) == b"":
                return sent
        except TimeoutError:
            continue
        except OSError:
            return sent
    return most


@pytest.mark.parametrize(
    "text",
    [
        b"GET /healthz HTTP/1.1\r\nHost: localhost\r\nX-Slow: " + b"a" * 200,
        b"a" * 200,
        b"POST /metrics HTTP/1.1\r\nHost: localhost\r\nContent-Length: 9999\r\n\r\n" + b"a" * 200,
    ],
    ids=["header", "first line", "body"],
)
def test_a_slow_request_is_closed_at_its_total_deadline(server, text):
    whole, _, _ = text.partition(b"aaaa")
    with connected(server) as client:
        client.sendall(whole)
        assert drip(client, b"a" * 200, 120) < 120, "the server waited thirty seconds for a request"


def test_a_client_that_does_not_read_its_response_is_disconnected(server):
    with connected(server) as client:
        client.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 1024)
        client.sendall(b"GET /metrics HTTP/1.1\r\nHost: localhost\r\n\r\n" * 2000)
        assert ask(server, "/healthz") == (200, "ok\n")


def test_clients_that_send_one_byte_at_a_time_do_not_block_other_clients(server):
    clients = [connected(server) for _ in range(300)]
    for _ in range(5):
        for client in clients:
            with contextlib.suppress(OSError):  # the server may have closed the oldest connections
                client.sendall(b"G")
        assert ask(server, "/healthz") == (200, "ok\n")
        assert ask(server, "/metrics")[0] == 200
        time.sleep(0.2)
    for client in clients:
        client.close()


def test_an_endless_first_line_is_cut_off(server):
    with connected(server) as endless:
        with contextlib.suppress(OSError):
            endless.sendall(b"GET /" + b"a" * 10_000_000)
        assert ask(server, "/healthz") == (200, "ok\n")
        with contextlib.suppress(ConnectionResetError):  # the server may close with unread bytes
            assert not endless.recv(100).startswith(b"HTTP/1.1 200")


def test_requests_with_a_foreign_host_name_are_refused(server):
    foreign = ("evil.example", "evil.example:9464", "127.0.0.1.evil.example", "10.0.0.1")
    for host in (*foreign, "", "[", "a@127.0.0.1", "127.0.0.1/x"):
        for path in ("/", "/healthz", "/readyz", "/metrics", "/nothing"):
            status, text = ask(server, path, Host=host)
            assert status in {400, 421}, (host, path)
            assert "minivla_" not in text


def test_requests_with_loopback_names_are_answered(server):
    for host in ("127.0.0.1", "localhost", "LOCALHOST.:9464", "[::1]:9464", "127.1.2.3:1"):
        assert ask(server, "/healthz", Host=host)[0] == 200


def test_a_server_on_all_addresses_answers_only_to_addresses_and_its_own_name():
    everywhere, one = HttpAddress("0.0.0.0", 9464), HttpAddress("gw1.example.org", 9464)
    for host in ("10.1.2.3:9464", "[fe80::1]:9464", socket.gethostname(), "localhost"):
        assert is_own_name(host, everywhere)
    assert not is_own_name("evil.example", everywhere)
    assert is_own_name("gw1.example.org:9464", one)
    assert not is_own_name("10.1.2.3", one)


def test_requests_with_a_configured_name_are_answered_and_others_are_not(opened):
    address = parse_address("127.0.0.1:0", None, names=("Minivla.example.org", "coordinator"))
    with StatusServer(address, opened.health) as named:
        for host in ("minivla.example.org", "MINIVLA.example.org:443", "coordinator:9464", "localhost"):
            assert ask(named, "/healthz", Host=host)[0] == 200
        for host in ("other.example.org", "coordinator.evil.example", "coordinator@evil.example"):
            status, text = ask(named, "/metrics", Host=host)
            assert status in {400, 421}
            assert "minivla_" not in text
    for name in ("", "a b", "*.example.org", "x" * 254, "-a", "http://a"):
        with pytest.raises(UsageError, match="--host-name"):
            parse_address("127.0.0.1:0", None, names=(name,))


def test_many_concurrent_requests_are_all_answered_or_refused(server):
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
    assert set(answers) == {200}
    assert ask(server, "/healthz")[0] == 200


def test_a_taken_address_is_named(opened, server):
    port = int(server.url.rpartition(":")[2])
    with pytest.raises(WorldError, match=f"127.0.0.1:{port}"):
        StatusServer(HttpAddress("127.0.0.1", port), opened.health)


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
