"""Hostile peers and broken hosts against a real coordinator: the other workers continue."""

from __future__ import annotations

import json
import threading
from collections.abc import Iterator
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import pytest
import structlog
import zenoh

from coordinator.admin import administer
from coordinator.ledger.hosts import SESSIONS_OF_HOST
from coordinator.ledger.opening import ledger_url_of
from coordinator.ledger.reading.audit import ledger_trouble
from coordinator.options import CoordinatorOptions
from coordinator.protocol.zenoh_config import client_config
from coordinator.service import Coordinator
from coordinator.settings import CoordinatorSettings
from schemas.dataset.rows import summary_of
from schemas.protocol.administration import AdminAction, AdminReply, AdminRequest
from schemas.protocol.keys import Verb, verb_key
from schemas.protocol.messages import PROTOCOL, Ack, Beat, BeatReply, Hello, HelloReply, Refusal
from schemas.support.product import product_version
from schemas.terms import FailReason
from tests.builders.bundle import parts_for
from tests.builders.ledger import room_catalog, room_plan
from tests.builders.shared_validator import SharedValidator
from tests.builders.wire_worker import WireWorker, bundle_for, until

ANY_PORT = ("tcp/127.0.0.1:0",)
SETTINGS = CoordinatorSettings(reserve_bytes=0, retry_after_s=0.1, pullers=1, pull_timeout_s=1.0)
LEASE = {"job_id": 1, "fence": 1, "token": "0" * 32}
REPORT = {"sid": "host.1", "lease": LEASE}
EPISODES = 4


@pytest.fixture(params=["sqlite", "postgresql"])
def url(request: pytest.FixtureRequest) -> str | None:
    """URL of an empty PostgreSQL database, or `None` for SQLite in the dataset directory."""
    return request.getfixturevalue("postgres_server").new_database() if request.param == "postgresql" else None


@pytest.fixture
def hub(url: str | None, tmp_path: Path, checker: SharedValidator) -> Iterator[Coordinator]:
    """A coordinator with a ledger in SQLite or PostgreSQL; checks at the end that the ledger is valid."""
    catalog = room_catalog(tmp_path)
    with Coordinator(
        tmp_path / "out",
        room_plan(EPISODES),
        catalog,
        CoordinatorOptions(listen=ANY_PORT, ledger_url=url, settings=SETTINGS, checker=checker),
    ) as running:
        yield running
    assert ledger_trouble(ledger_url_of(tmp_path / "out", url), catalog) == ""


@pytest.fixture
def peer(hub: Coordinator) -> Iterator[WireWorker]:
    with WireWorker(hub.endpoints, hub.run, sid="host.1") as speaking:
        yield speaking


def with_every_number(message: dict[str, Any], number: Any) -> Iterator[dict[str, Any]]:
    """Yields copies of a message, one for each value at any depth, with that value replaced by `number`."""
    for key, value in message.items():
        if isinstance(value, dict):
            yield from (message | {key: inner} for inner in with_every_number(value, number))
        else:
            yield message | {key: number}


MESSAGES: dict[str, dict[str, Any]] = {
    "hello": {"sid": "host.1", "host": "host", "slots": 1, "version": product_version(), "protocol": PROTOCOL},
    "claim": {"sid": "host.1", "token": "0" * 32},
    "beat": {"sid": "host.1", "via": "0"},
    "done": REPORT | {"sha256": "0" * 64, "size": 7},
    "fail": REPORT | {"reason": "crash", "detail": "x", "steps": 1, "seconds": 1.0},
    "hold": {"lease": LEASE, "seconds": 1.0},
    "inventory": {"first": 1, "last": 1, "files": []},
    "orders": {"router": "0", "most": 1},
    "refused": REPORT | {"detail": "x"},
    "join": {"version": product_version(), "protocol": PROTOCOL, "router": "0"},
    "archived": {"summary": summary_of(parts_for().meta, "0" * 64, 7).model_dump(mode="json"), "lease": LEASE},
    "admin": {"action": "retry", "indices": []},
}
VALUES = [2**31, 2**63, 2**64, -(2**63), 10**300, 1e308, "x" * 5000, "\0", [[]] * 1000, None, {"a": 1}, True]


@pytest.mark.parametrize("verb", MESSAGES)
def test_no_message_of_a_peer_makes_the_coordinator_fail(hub, peer, verb):
    with structlog.testing.capture_logs() as lines:
        for value in VALUES:
            for message in with_every_number(MESSAGES[verb], value):
                assert answer(peer, verb, message) is not None, message
    assert [line for line in lines if line["log_level"] in {"warning", "error", "critical"}] == []
    assert isinstance(peer.hello(product_version()), HelloReply)


def answer(peer: WireWorker, verb: str, message: dict[str, Any]) -> bytes | None:
    """Sends a message and returns the raw reply; `None` if there is none."""
    key = verb_key(peer.run, peer.host, Verb(verb))
    channel = zenoh.handlers.FifoChannel(4)
    for reply in peer._session.get(key, channel, payload=json.dumps(message), timeout=5.0):
        if reply.ok is not None:
            return reply.ok.payload.to_bytes()
    return None


def test_refusals_of_one_peer_do_not_fill_the_log(hub, peer):
    with structlog.testing.capture_logs() as lines:
        for _ in range(200):
            assert isinstance(peer.ask("done", b'{"job_id": 9223372036854775808}', Ack), Refusal)
    refused = [line for line in lines if line["event"] == "refused"]
    assert 0 < len(refused) < 100
    assert len(repr(refused[0])) < 1000


def test_a_long_key_is_refused_without_being_repeated(hub, peer):
    for part in ("c/host/" + "x" * 30_000, "c/" + "h" * 30_000 + "/claim", "scene/" + "f" * 30_000):
        key = f"factory/{hub.run}/v1/{part}"
        with zenoh.open(client_config(hub.endpoints, 2.0)) as session:
            replies = list(session.get(key, zenoh.handlers.FifoChannel(4), payload=b"{}", timeout=5.0))
        assert [len(reply.err.payload.to_bytes()) < 200 for reply in replies if reply.err is not None] == [True]
        assert [reply for reply in replies if reply.ok is not None] == []


def test_a_long_name_of_a_field_is_refused_without_being_repeated(hub, peer):
    for length in (10_000, 1_000_000):
        refusal = peer.ask("claim", json.dumps({"x" * length: 1}).encode(), Ack)
        assert isinstance(refusal, Refusal)
        assert len(refusal.error) < 1000


@pytest.mark.slow
def test_a_host_has_a_bounded_number_of_sessions(hub, peer):
    mine = product_version()
    replies = [
        peer.ask(Verb.HELLO, Hello(sid=f"host.{number}", host="host", slots=1, version=mine), HelloReply)
        for number in range(SESSIONS_OF_HOST + 5)
    ]
    assert sum(isinstance(reply, HelloReply) for reply in replies) == SESSIONS_OF_HOST
    assert isinstance(replies[-1], Refusal)
    assert "sessions" in replies[-1].error
    assert isinstance(peer.ask(Verb.BEAT, Beat(sid="host.99999"), BeatReply), BeatReply)
    assert len(hub.progress().workers) == SESSIONS_OF_HOST
    with WireWorker(hub.endpoints, hub.run, "other") as other:
        assert isinstance(other.hello(mine), HelloReply)


def test_a_lease_token_is_refused_if_another_host_sends_it(hub, peer):
    job, lease = peer.job()
    with WireWorker(hub.endpoints, hub.run, "thief") as thief:
        assert not thief.fail(lease, FailReason.RELEASED)
        assert not thief.deliver(lease, b"mine")
        assert thief.claim(lease.token).lease is None
        assert thief.beat([lease]).lost == (lease,)
    assert peer.beat([lease]).lost == ()
    assert peer.deliver(lease, bundle_for(job))
    until(lambda: hub.progress().jobs["archived"] == 1)


def test_a_restarted_worker_of_the_same_host_continues_its_lease(hub, peer):
    job, lease = peer.job()
    with WireWorker(hub.endpoints, hub.run, sid="host.2") as again:
        assert again.beat([lease]).lost == ()
        assert again.deliver(lease, bundle_for(job))
        until(lambda: hub.progress().jobs["archived"] == 1)


def test_a_host_that_announces_invalid_bundles_is_barred_and_can_be_released(hub, peer, url, tmp_path):
    stop = threading.Event()

    def spoil() -> None:
        while not stop.is_set():
            reply = peer.claim()
            if reply.lease is not None:
                peer.deliver(reply.lease, b"7 bytes")
            stop.wait(0.05)

    spoiling = threading.Thread(target=spoil)
    spoiling.start()
    try:
        until(lambda: any(host.strikes >= 2 for host in hub.progress().hosts))
        with WireWorker(hub.endpoints, hub.run, "good") as good:
            good.hello(product_version())

            def is_finished() -> bool:
                reply = good.claim()
                if reply.job is not None and reply.lease is not None:
                    good.deliver(reply.lease, bundle_for(reply.job))
                good.beat()
                return hub.is_finished()

            until(is_finished)
    finally:
        stop.set()
        spoiling.join()
    assert hub.progress().jobs["archived"] == EPISODES
    request = AdminRequest(action=AdminAction.RELEASE, hosts=("host",))
    assert administer(tmp_path / "out", request, datetime.now(UTC), url).hosts == ("host",)
    assert hub.progress().hosts == ()


def test_hosts_are_released_without_a_running_coordinator(tmp_path):
    catalog, out = room_catalog(tmp_path), tmp_path / "out"
    with (
        Coordinator(out, room_plan(1), catalog, CoordinatorOptions(listen=ANY_PORT, settings=SETTINGS)) as hub,
        WireWorker(hub.endpoints, hub.run) as peer,
    ):
        _, lease = peer.job()
        peer.deliver(lease, b"7 bytes")
        until(lambda: len(hub.progress().hosts) == 1)
    request = AdminRequest(action=AdminAction.RELEASE)
    assert administer(out, request, datetime.now(UTC)).hosts == ("host",)
    assert administer(out, request, datetime.now(UTC)).hosts == ()


def test_a_finished_run_is_announced_in_the_heartbeat_reply_and_waits_for_its_workers(hub):
    farewell = threading.Thread(target=hub.wait_for_workers_to_disconnect)
    with WireWorker(hub.endpoints, hub.run) as peer:
        assert not peer.beat().finished
        peer.ask(Verb.ADMIN, AdminRequest(action=AdminAction.CANCEL), AdminReply)
        assert peer.beat().finished
        farewell.start()
        farewell.join(5.0)
        assert farewell.is_alive()
    farewell.join(60)
    assert not farewell.is_alive()
