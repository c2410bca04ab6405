"""An evaluation on workers of a collection behind mTLS; the certificate of the evaluation has no other rights."""

from __future__ import annotations

import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
import zenoh

from coordinator.gateway.service import Gateway
from coordinator.options import CoordinatorOptions
from coordinator.protocol.ask import ask_presence, ask_progress
from coordinator.protocol.tls import Guard
from coordinator.protocol.zenoh_config import client_config
from coordinator.service import Coordinator
from coordinator.settings import CoordinatorSettings
from factory.dataset.reader import Dataset
from factory.eval.remote.fleet import FleetAccess, run_fleet
from factory.keys import revoke
from schemas.errors import TransientError, WorldError
from schemas.protocol.administration import AdminAction, AdminReply, AdminRequest
from schemas.protocol.keys import BundleRange, Chunk, Verb, bundle_key, bundle_selector, verb_key, verb_pattern
from schemas.protocol.messages import Claim, ClaimReply, Done
from schemas.support.child import python_module
from schemas.support.product import product_version
from tests.builders.evaluation import open_store, standing_still
from tests.builders.keys import files_of, make_authority
from tests.builders.ledger import room_catalog, room_plan
from tests.builders.wire_worker import WireWorker, bundle_for, until
from tests.builders.worker import WorkerThread, settings_for

COLLECT = python_module("tests.builders.small_simulation", "0.2")
EVALUATE = python_module("factory.eval.remote.eval_worker")
SETTINGS = CoordinatorSettings(
    reserve_bytes=0, retry_after_s=0.1, pullers=1, pull_timeout_s=1.0, lease_ttl_s=15.0, admission_s=0.2
)
ANY_PORT = ("tls/127.0.0.1:0",)


@pytest.fixture
def pki(tmp_path: Path) -> Path:
    return make_authority(tmp_path / "pki", ("node",), ("admin",), gateways=("gw1",), evaluators=("desk", "other"))


@pytest.fixture
def hub(pki: Path, tmp_path: Path) -> Iterator[Coordinator]:
    """The coordinator of a collection with so many episodes that it does not end during a test."""
    plan, catalog = room_plan(2000), room_catalog(tmp_path)
    guard = Guard(pki / "hub")
    with Coordinator(
        tmp_path / "out", plan, catalog, CoordinatorOptions(listen=ANY_PORT, settings=SETTINGS, guard=guard)
    ) as running:
        yield running


@contextmanager
def working(endpoint: str, pki: Path, folder: Path) -> Iterator[None]:
    """Runs a worker of the collection that supports evaluations."""
    more = {"host": "node", "tls": files_of(pki, "node"), "command": COLLECT, "eval_command": EVALUATE}
    with WorkerThread(settings_for(endpoint, folder / "worker", **more)):
        yield


def evaluates(drives: Dataset, hub: Coordinator, pki: Path, folder: Path) -> list[tuple[str, int]]:
    """Evaluates two episodes without motion; returns end and number of steps of each."""
    campaign = standing_still(drives)
    access = FleetAccess(connect=hub.endpoints, guard=Guard(pki / "desk", listens=False))
    with open_store(folder / "results", campaign) as store:
        assert run_fleet(campaign, drives.meta.plan, store, access, threading.Event(), lambda _pace: None)
        return [(row.end, row.num_steps) for row in store.results("stop")]


def is_answered(hub: Coordinator, pki: Path) -> bool:
    try:
        ask_presence(hub.endpoints, "desk", files_of(pki, "desk"))
    except TransientError:
        return False
    return True


def test_workers_with_tls_run_an_evaluation_and_resume_the_collection(drives, hub, pki, tmp_path):
    with working(hub.endpoints[0], pki, tmp_path):
        until(lambda: hub.progress().jobs["archived"] > 0)
        assert evaluates(drives, hub, pki, tmp_path) == [("timeout", 10)] * 2
        before = hub.progress().jobs["archived"]
        until(lambda: hub.progress().jobs["archived"] > before)


@pytest.mark.slow
def test_workers_behind_a_gateway_run_an_evaluation(drives, hub, pki, tmp_path):
    guard = Guard(pki / "gw1", of_gateway=True)
    with (
        Gateway(tmp_path / "gw1", "gw1", hub.endpoints, ANY_PORT, SETTINGS, guard=guard) as gateway,
        working(gateway.endpoints[0], pki, tmp_path),
    ):
        until(lambda: hub.progress().jobs["archived"] > 0)
        assert evaluates(drives, hub, pki, tmp_path) == [("timeout", 10)] * 2


def test_an_unauthorised_evaluation_names_the_host_list(drives, hub, pki, tmp_path):
    revoke(pki, "desk")
    until(lambda: not is_answered(hub, pki))
    with pytest.raises(TransientError, match=r"does not admit 'desk' \(its hosts\.txt\)"):
        evaluates(drives, hub, pki, tmp_path)


def test_an_evaluator_can_neither_claim_jobs_nor_administer_the_run(hub, pki):
    with WireWorker(hub.endpoints, hub.run, "desk", files_of(pki, "desk")) as claiming_peer:
        assert claiming_peer.hello(product_version()) is None
        assert claiming_peer.ask(Verb.CLAIM, Claim(sid=claiming_peer.sid, token="0" * 32), ClaimReply) is None
        assert claiming_peer.ask(Verb.ADMIN, AdminRequest(action=AdminAction.CANCEL), AdminReply) is None
    assert hub.progress().jobs["pending"] == 2000


def test_an_evaluator_cannot_read_the_progress_of_a_collection(hub, pki):
    assert is_answered(hub, pki)
    with pytest.raises(WorldError) as caught:
        ask_progress(hub.endpoints, "desk", files_of(pki, "desk"))
    said = str(caught.value)
    assert "does not serve the request `progress` for 'desk': its role is evaluator" in said
    assert "needs the role worker or operator" in said
    assert "factory keys host DIR NAME --role operator" in said
    assert "Verb" not in said
    assert ask_progress(hub.endpoints, "admin", files_of(pki, "admin")).planned == 2000


def test_an_evaluator_can_neither_receive_nor_answer_messages_of_the_collection(hub, pki):
    heard: list[str] = []

    def answer_falsely(query: zenoh.Query) -> None:
        with query:
            heard.append(str(query.key_expr))
            query.reply(verb_key(hub.run, "node", Verb.CLAIM), b'{"finished": true}')

    with (
        zenoh.open(client_config(hub.endpoints, 2.0, files_of(pki, "desk"))) as listener,
        WireWorker(hub.endpoints, hub.run, "node", files_of(pki, "node")) as worker,
    ):
        listener.declare_queryable(verb_pattern(hub.run), answer_falsely)
        listener.declare_queryable(verb_pattern("*"), answer_falsely)
        time.sleep(0.3)
        worker.hello(product_version())
        job, lease = worker.job()
        done = Done(sid=worker.sid, lease=lease, sha256="0" * 64, size=9, via=worker.via)
        worker.spool[lease.job_id, lease.fence] = done, b"secret" * 100
        for run in (hub.run, "*"):
            selector = bundle_selector(run, worker.sid, [BundleRange(lease.job_id, lease.fence, Chunk(0, 10))])
            replies = listener.get(selector, zenoh.handlers.FifoChannel(4), timeout=2.0)
            assert [reply for reply in replies if reply.ok is not None] == []
        listener.declare_queryable(bundle_key(hub.run, worker.sid), answer_falsely)
        time.sleep(0.3)
        assert worker.deliver(lease, bundle_for(job))
        until(lambda: hub.progress().jobs["archived"] == 1)
    assert heard == []
