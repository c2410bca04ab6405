"""A gateway behind mTLS: it can forward requests of its workers and send gateway requests, and has no other rights."""

from __future__ import annotations

import contextlib
import shutil
import time
from collections.abc import Iterator
from pathlib import Path

import pytest
import zenoh

from coordinator.gateway.service import Gateway
from coordinator.options import CoordinatorOptions
from coordinator.protocol.relay import ExtendLease, Join, Orders, OrdersRequest
from coordinator.protocol.tls import Guard
from coordinator.protocol.zenoh_config import client_config
from coordinator.service import Coordinator
from coordinator.settings import CoordinatorSettings
from factory.keys import revoke
from schemas.base import Model
from schemas.errors import UsageError
from schemas.protocol.administration import AdminAction, AdminReply, AdminRequest
from schemas.protocol.identity import Role
from schemas.protocol.keys import Verb, bundle_key, verb_key, verb_pattern
from schemas.protocol.messages import Ack, HelloReply
from schemas.support.product import product_version
from tests.builders.keys import files_of, make_authority
from tests.builders.ledger import room_catalog, room_plan
from tests.builders.wire_worker import WireWorker, bundle_for, until

SETTINGS = CoordinatorSettings(
    reserve_bytes=0, retry_after_s=0.1, pullers=1, pull_timeout_s=1.0, lease_ttl_s=60.0, admission_s=0.2
)
ANY_PORT = ("tls/127.0.0.1:0",)
VERSION = product_version()


@pytest.fixture(scope="module")
def pki(tmp_path_factory: pytest.TempPathFactory) -> Path:
    root = tmp_path_factory.mktemp("tls") / "pki"
    return make_authority(root, ("node", "other"), ("admin",), gateways=("gw1", "gw2"))


@pytest.fixture
def hub(pki: Path, tmp_path: Path) -> Iterator[Coordinator]:
    plan, catalog = room_plan(2), room_catalog(tmp_path)
    with Coordinator(
        tmp_path / "out",
        plan,
        catalog,
        CoordinatorOptions(listen=ANY_PORT, settings=SETTINGS, guard=Guard(pki / "hub")),
    ) as running:
        yield running


@pytest.fixture
def gateway(hub: Coordinator, pki: Path, tmp_path: Path) -> Iterator[Gateway]:
    guard = Guard(pki / "gw1", of_gateway=True)
    with Gateway(tmp_path / "gw1", "gw1", hub.endpoints, ANY_PORT, SETTINGS, guard=guard) as running:
        yield running


def asks(hub: Coordinator, pki: Path, name: str, verb: Verb, message: Model, under: str = "") -> list[bytes]:
    """Sends a request with the certificate of `name`, as `name` or as the host `under`; returns the replies."""
    with zenoh.open(client_config(hub.endpoints, 2.0, files_of(pki, name))) as session:
        key = verb_key(hub.run, under or name, verb)
        replies = session.get(key, zenoh.handlers.FifoChannel(4), payload=message.model_dump_json(), timeout=2.0)
        return [reply.ok.payload.to_bytes() for reply in replies if reply.ok is not None]


def test_a_worker_behind_a_gateway_completes_a_job(hub, gateway, pki, tmp_path):
    with WireWorker(gateway.endpoints, hub.run, "node", files_of(pki, "node")) as worker:
        assert isinstance(worker.hello(VERSION), HelloReply)
        for _ in range(2):
            job, lease = worker.job()
            assert worker.deliver(lease, bundle_for(job))
        until(hub.is_finished)
        assert len(worker.beat().drop) == 2
    assert hub.progress().by_gateway == {"gw1": 2}
    assert hub.progress().workers[0].host == "node"
    assert list((tmp_path / "out" / "episodes").iterdir()) == []


def test_a_gateway_admits_only_workers(hub, gateway, pki):
    for name in ("admin", "gw2"):
        with WireWorker(gateway.endpoints, hub.run, name, files_of(pki, name)) as foreign_peer:
            assert foreign_peer.hello(VERSION) is None
            assert foreign_peer.ask(Verb.ADMIN, AdminRequest(action=AdminAction.CANCEL), AdminReply) is None
            assert foreign_peer.ask(Verb.ORDERS, OrdersRequest(router="a", most=9), Orders) is None
    with WireWorker(gateway.endpoints, hub.run, "other", files_of(pki, "node")) as false_peer:
        assert false_peer.hello(VERSION) is None
    assert hub.progress().jobs["pending"] == 2
    assert hub.progress().workers == ()


def test_only_gateways_can_send_gateway_requests(hub, pki):
    join = Join(version=VERSION, router="a")
    assert asks(hub, pki, "gw1", Verb.JOIN, join)
    for name in ("node", "admin", "gw2"):
        assert asks(hub, pki, name, Verb.JOIN, join, under="gw1") == []
    assert asks(hub, pki, "node", Verb.JOIN, join) == []


def test_a_gateway_cannot_send_operator_requests(hub, pki):
    request = AdminRequest(action=AdminAction.CANCEL)
    assert asks(hub, pki, "gw1", Verb.ADMIN, request) == []
    assert asks(hub, pki, "gw1", Verb.ADMIN, request, under="admin") == []
    assert hub.progress().jobs["cancelled"] == 0


def test_a_gateway_can_neither_answer_as_coordinator_nor_serve_bundles(hub, gateway, pki):
    lies: list[str] = []

    def answer_falsely(query: zenoh.Query) -> None:
        with query:
            lies.append(str(query.key_expr))
            query.reply(str(query.key_expr), b'{"accepted": true}')

    with zenoh.open(client_config(hub.endpoints, 2.0, files_of(pki, "gw2"))) as false_peer:
        false_peer.declare_queryable(verb_pattern(hub.run), answer_falsely)
        false_peer.declare_queryable(bundle_key(hub.run, "*"), answer_falsely)
        time.sleep(0.3)
        with WireWorker(gateway.endpoints, hub.run, "node", files_of(pki, "node")) as worker:
            _, lease = worker.job()
            (answer,) = asks(hub, pki, "gw1", Verb.HOLD, ExtendLease(lease=lease, seconds=1.0))
            assert Ack.model_validate_json(answer).accepted
            assert worker.deliver(lease, b"nothing that is an episode")
            until(lambda: hub.progress().attempts.get("invalid") == 1)  # the bytes of the worker were validated
    assert lies == []


def test_a_revoked_gateway_loses_its_access(pki, tmp_path):
    mine = tmp_path / "pki"
    shutil.copytree(pki, mine)
    with Coordinator(
        tmp_path / "out",
        room_plan(2),
        room_catalog(tmp_path),
        CoordinatorOptions(listen=ANY_PORT, settings=SETTINGS, guard=Guard(mine / "hub")),
    ) as hub:
        join = Join(version=VERSION, router="a")
        assert asks(hub, mine, "gw1", Verb.JOIN, join)
        assert mine / "gw2" / "hosts.txt" in revoke(mine, "gw1")

        def is_out() -> bool:
            with contextlib.suppress(zenoh.ZError):
                return asks(hub, mine, "gw1", Verb.JOIN, join) == []
            return False

        until(lambda: is_out() and hub_is_up(hub, mine) and is_out())  # the session may reconnect in between
        assert asks(hub, mine, "gw2", Verb.JOIN, join)


def hub_is_up(hub: Coordinator, pki: Path) -> bool:
    try:
        return bool(asks(hub, pki, "gw2", Verb.JOIN, Join(version=VERSION, router="b")))
    except zenoh.ZError:
        return False


def test_only_the_host_list_of_a_gateway_may_name_a_coordinator(pki):
    assert Guard(pki / "gw1", of_gateway=True).admitted() == {
        "hub": Role.COORDINATOR,
        "node": Role.WORKER,
        "other": Role.WORKER,
    }
    assert "hub" not in Guard(pki / "hub").admitted()
    with pytest.raises(UsageError, match="coordinator"):
        Guard(pki / "gw1")
