"""mTLS and access control over zenoh on loopback: admitted clients can work, requests of other clients are refused."""

from __future__ import annotations

import json
import secrets
import shutil
import time
from collections.abc import Iterator
from datetime import UTC, datetime
from pathlib import Path

import pytest
import zenoh
from click.testing import CliRunner

from coordinator.admin import administer
from coordinator.options import CoordinatorOptions
from coordinator.protocol.ask import ask_progress
from coordinator.protocol.tls import Guard
from coordinator.protocol.zenoh_config import client_config, router_config
from coordinator.service import Coordinator
from coordinator.settings import CoordinatorSettings
from factory.cli.jobs import command as jobs
from factory.keys import admit, revoke
from factory.support.listen import split_resolvable
from schemas.errors import TransientError, WorldError
from schemas.protocol.address_file import find_endpoints, read_address
from schemas.protocol.administration import AdminAction, AdminReply, AdminRequest
from schemas.protocol.identity import Role, TlsFiles
from schemas.protocol.keys import Chunk, Verb, alive_key, bundle_key, scene_selector, verb_key, verb_pattern
from schemas.protocol.messages import Claim, ClaimReply, HelloReply
from schemas.support.child import python_module
from schemas.support.product import product_version
from tests.builders.bundle import parts_for
from tests.builders.keys import files_of, make_authority
from tests.builders.ledger import room_catalog, room_plan
from tests.builders.ports import free_endpoint
from tests.builders.wire_worker import WireWorker, bundle_for, until
from tests.builders.worker import WorkerThread, settings_for

ANY_PORT = ("tls/127.0.0.1:0",)


@pytest.fixture(scope="module")
def pki(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return make_authority(tmp_path_factory.mktemp("tls") / "pki", ("node", "node-1", "other"), ("admin",))


@pytest.fixture(scope="module")
def foreign(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Another authority whose hosts have the same names."""
    return make_authority(tmp_path_factory.mktemp("foreign") / "pki", ("node",), ("admin",))


def opened_at(folder: Path, pki: Path, endpoint: str = ANY_PORT[0], lease_ttl_s: float = 60.0) -> Coordinator:
    settings = CoordinatorSettings(
        reserve_bytes=0, retry_after_s=0.1, pullers=1, pull_timeout_s=1.0, lease_ttl_s=lease_ttl_s, admission_s=0.2
    )
    guard = Guard(pki / "hub")
    return Coordinator(
        folder / "out",
        room_plan(2),
        room_catalog(folder),
        CoordinatorOptions(listen=(endpoint,), settings=settings, guard=guard),
    )


@pytest.fixture
def hub(pki: Path, tmp_path: Path) -> Iterator[Coordinator]:
    with opened_at(tmp_path, pki) as running:
        yield running


def can_connect(endpoints: tuple[str, ...], tls: TlsFiles | None) -> bool:
    try:
        zenoh.open(client_config(endpoints, 2.0, tls)).close()
    except zenoh.ZError:
        return False
    return True


def answers(session: zenoh.Session, selector: str, payload: str = "") -> list[bytes]:
    replies = session.get(
        selector,
        zenoh.handlers.FifoChannel(8),
        payload=payload,
        timeout=2.0,
        target=zenoh.QueryTarget.ALL,
        consolidation=zenoh.ConsolidationMode.NONE,
    )
    return [reply.ok.payload.to_bytes() for reply in replies if reply.ok is not None]


def test_an_admitted_worker_completes_a_job(hub, pki):
    with WireWorker(hub.endpoints, hub.run, "node", files_of(pki, "node")) as worker:
        assert isinstance(worker.hello(product_version()), HelloReply)
        for _ in range(2):
            job, lease = worker.job()
            assert worker.fetch(scene_selector(hub.run, job.scene_sha256, Chunk(0, 100)))
            assert worker.deliver(lease, bundle_for(job))
        until(hub.is_finished)
        assert len(worker.beat().drop) == 2


def test_the_real_worker_finds_its_run_and_delivers_every_episode(hub, pki, tmp_path):
    settings = settings_for(
        hub.endpoints[0],
        tmp_path / "host",
        host="node",
        tls=files_of(pki, "node"),
        command=python_module("tests.builders.small_simulation", "0.0"),
    )
    with WorkerThread(settings) as worker:
        until(hub.is_finished)
        assert worker.join() == 0
    assert hub.progress().workers[0].host == "node"


def test_a_worker_with_the_certificate_of_another_role_is_told_its_role(hub, pki, tmp_path):
    settings = settings_for(
        hub.endpoints[0], tmp_path / "host", host="admin", tls=files_of(pki, "admin"), wait_s=1.0, command=()
    )
    with WorkerThread(settings) as worker, pytest.raises(WorldError, match="its role is operator"):
        worker.join()


def test_a_client_without_a_certificate_of_the_authority_cannot_connect(hub, pki, foreign):
    assert can_connect(hub.endpoints, files_of(pki, "node"))
    plain = tuple(endpoint.replace("tls/", "tcp/") for endpoint in hub.endpoints)
    stolen_name = files_of(foreign, "node")
    assert not can_connect(plain, None)
    assert not can_connect(hub.endpoints, None)
    assert not can_connect(hub.endpoints, stolen_name)
    assert not can_connect(hub.endpoints, stolen_name._replace(ca=pki / "ca.pem"))
    assert hub.progress().workers == ()


def test_a_client_with_an_expired_certificate_cannot_connect(hub, pki, tmp_path):
    folder = tmp_path / "old"
    shutil.copytree(pki, folder)
    admit(folder, "node", Role.WORKER, (), 1, datetime(2026, 1, 1, tzinfo=UTC), renew=True)
    assert not can_connect(hub.endpoints, files_of(folder, "node"))


def test_a_signed_certificate_of_a_host_outside_the_host_list_gives_no_access(hub, pki, tmp_path):
    folder = tmp_path / "beside"
    shutil.copytree(pki, folder)
    admit(
        folder, "stranger", Role.WORKER, (), 1, datetime.now(UTC)
    )  # signed, but not in the host list of the coordinator
    with WireWorker(hub.endpoints, hub.run, "stranger", files_of(folder, "stranger")) as worker:
        assert worker.hello(product_version()) is None
    assert hub.progress().workers == ()


def test_a_host_cannot_send_requests_under_another_name(hub, pki):
    with WireWorker(hub.endpoints, hub.run, "other", files_of(pki, "node")) as false_peer:
        assert false_peer.hello(product_version()) is None
        assert false_peer.ask(Verb.CLAIM, Claim(sid=false_peer.sid, token=secrets.token_hex(16)), ClaimReply) is None
    assert hub.progress().workers == ()
    assert hub.progress().jobs["pending"] == 2


def test_a_host_cannot_send_operator_requests(hub, pki):
    request = AdminRequest(action=AdminAction.CANCEL)
    with WireWorker(hub.endpoints, hub.run, "node", files_of(pki, "node")) as worker:
        assert worker.ask(Verb.ADMIN, request, AdminReply) is None
    assert hub.progress().jobs["cancelled"] == 0


@pytest.mark.parametrize("victim", ["node-1", "other"])
def test_a_host_can_neither_serve_bundles_nor_declare_liveliness_in_the_name_of_another_host(hub, pki, victim):
    with WireWorker(hub.endpoints, hub.run, victim, files_of(pki, victim)) as honest:
        honest.hello(product_version())
        job, lease = honest.job()
        asked: list[str] = []

        def answer_falsely(query: zenoh.Query) -> None:
            with query:
                asked.append(str(query.key_expr))
                query.reply(bundle_key(hub.run, honest.sid), b"x" * 100)

        with zenoh.open(client_config(hub.endpoints, 2.0, files_of(pki, "node"))) as false_peer:
            false_peer.declare_queryable(bundle_key(hub.run, honest.sid), answer_falsely)
            false_peer.declare_queryable(bundle_key(hub.run, "*"), answer_falsely)
            token = false_peer.liveliness().declare_token(alive_key(hub.run, honest.sid))
            time.sleep(0.3)
            token.undeclare()  # if accepted, it would shorten the leases of the honest worker
            before = hub.progress()
            assert honest.deliver(lease, bundle_for(job))
            until(lambda: hub.progress().jobs["archived"] == 1)
            assert before.workers[0].leased == 1
        assert asked == []


def test_a_host_cannot_read_bundles_of_another_host(hub, pki):
    with WireWorker(hub.endpoints, hub.run, "other", files_of(pki, "other")) as honest:
        honest.hello(product_version())
        _, lease = honest.job()
        honest.is_frozen = True  # not even the coordinator can pull the bundle, so it remains in the spool
        honest.deliver(lease, b"secret" * 100)
        honest.is_frozen = False
        where = f"?job={lease.job_id};fence={lease.fence};off=0;n=10"
        with zenoh.open(client_config(hub.endpoints, 2.0, files_of(pki, "node"))) as listener:
            assert answers(listener, bundle_key(hub.run, honest.sid) + where) == []


def test_only_the_coordinator_can_answer_coordinator_requests(hub, pki):
    lies: list[str] = []

    def answer_falsely(query: zenoh.Query) -> None:
        with query:
            lies.append(str(query.key_expr))
            query.reply(verb_key(hub.run, "other", Verb.CLAIM), b'{"finished": true}')

    with zenoh.open(client_config(hub.endpoints, 2.0, files_of(pki, "node"))) as false_peer:
        false_peer.declare_queryable(verb_pattern(hub.run), answer_falsely)
        false_peer.declare_queryable(verb_key(hub.run, "other", Verb.CLAIM), answer_falsely)
        time.sleep(0.3)
        with zenoh.open(client_config(hub.endpoints, 2.0, files_of(pki, "other"))) as honest:
            claim = Claim(sid="other.1", token=secrets.token_hex(16)).model_dump_json()
            (reply,) = answers(honest, verb_key(hub.run, "other", Verb.CLAIM), claim)
    assert ClaimReply.model_validate_json(reply).job is not None
    assert lies == []


def test_a_worker_certificate_is_not_accepted_as_a_coordinator_certificate(pki):
    endpoint = free_endpoint().replace("tcp/", "tls/")
    with zenoh.open(router_config([endpoint], 2.0, files_of(pki, "node"), {"other": Role.WORKER})):
        assert not can_connect((endpoint,), files_of(pki, "other"))
    with zenoh.open(router_config([endpoint], 2.0, files_of(pki, "hub"), {"other": Role.WORKER})):
        assert can_connect((endpoint,), files_of(pki, "other"))


def test_an_operator_can_administer_the_run_and_cannot_claim_jobs(hub, pki, tmp_path):
    files = files_of(pki, "admin")
    assert ask_progress(hub.endpoints, "admin", files).planned == 2
    unresolvable = "tls/name.invalid:7447"
    assert ask_progress((unresolvable, *hub.endpoints), "admin", files).planned == 2
    request = AdminRequest(action=AdminAction.CANCEL, indices=(1,))
    assert administer(tmp_path / "out", request, datetime.now(UTC), name="admin", tls=files).changed == (1,)
    with WireWorker(hub.endpoints, hub.run, "admin", files) as claiming_peer:
        assert (
            claiming_peer.ask(Verb.CLAIM, Claim(sid=claiming_peer.sid, token=secrets.token_hex(16)), ClaimReply) is None
        )
    with pytest.raises(TransientError, match=r"hosts\.txt"):
        ask_progress(hub.endpoints, "stranger", files)
    with pytest.raises(TransientError, match="no coordinator at"):  # not reachable without a certificate
        administer(tmp_path / "out", request, datetime.now(UTC))


def test_commands_on_the_machine_of_a_coordinator_use_loopback_and_others_their_endpoint(pki, tmp_path):
    """The name in the certificate cannot be resolved, as with `factory keys host pki hub` on most machines."""
    options = CoordinatorOptions(
        listen=("tls/0.0.0.0:0",),
        hosts=("name.invalid",),
        settings=CoordinatorSettings(reserve_bytes=0),
        guard=Guard(pki / "hub"),
    )
    root = tmp_path / "out"
    with Coordinator(root, room_plan(2), room_catalog(tmp_path), options) as hub:
        port = hub.endpoints[0].rpartition(":")[2]
        assert hub.reachable == (f"tls/name.invalid:{port}",)
        assert find_endpoints((f"@{root}",)) == (f"tls/127.0.0.1:{port}",)
        assert split_resolvable(hub.reachable) == ((), hub.reachable)
        for words in (["pause", str(root)], ["resume", "-", "--connect", f"tls/127.0.0.1:{port}"]):
            started = time.monotonic()
            ended = CliRunner().invoke(jobs, [*words, "--tls", str(pki / "admin")])
            assert ended.exit_code == 0, ended.output
            assert time.monotonic() - started < 8.0
            assert hub.progress().paused == (words[0] == "pause")
        elsewhere = json.loads((root / ".coordinator.json").read_text()) | {"host": "other-machine"}
        (root / ".coordinator.json").write_text(json.dumps(elsewhere))
        assert find_endpoints((f"@{root}",)) == hub.reachable


def test_an_address_file_of_an_older_version_is_read(tmp_path):
    (tmp_path / ".coordinator.json").write_text('{"run": "r", "endpoints": ["tcp/10.0.0.1:7447"], "pid": 7}')
    assert find_endpoints((f"@{tmp_path}",)) == ("tcp/10.0.0.1:7447",)
    for damage in (
        "[]",
        '{"run": "r", "endpoints": 3, "pid": 7}',
        '{"run": "r", "endpoints": [], "pid": 7, "bound": ["x"]}',
    ):
        (tmp_path / ".coordinator.json").write_text(damage)
        assert read_address(tmp_path) is None


def test_an_operator_who_was_just_admitted_can_administer_the_run(pki, tmp_path):
    mine = tmp_path / "pki"
    shutil.copytree(pki, mine)
    revoke(mine, "admin")
    with opened_at(tmp_path, mine) as hub:
        admit(mine, "admin", Role.OPERATOR, (), 30, datetime.now(UTC), renew=True)
        request = AdminRequest(action=AdminAction.PAUSE)
        administer(tmp_path / "out", request, datetime.now(UTC), name="admin", tls=files_of(mine, "admin"))
        assert hub.progress().planned == 2


def test_a_revoked_host_loses_access_while_others_continue(pki, tmp_path):
    mine = tmp_path / "pki"
    shutil.copytree(pki, mine)
    with (
        opened_at(tmp_path, mine) as hub,
        WireWorker(hub.endpoints, hub.run, "node", files_of(mine, "node")) as bad,
        WireWorker(hub.endpoints, hub.run, "other", files_of(mine, "other")) as good,
    ):
        assert isinstance(bad.hello(product_version()), HelloReply)
        job, lease = good.job()
        revoke(mine, "node")
        until(lambda: bad.hello(product_version()) is None)
        until(lambda: good.hello(product_version()) is not None)
        good.spool.clear()
        assert good.deliver(lease, parts_for(job).write())
        until(lambda: hub.progress().jobs["archived"] == 1)
        assert bad.hello(product_version()) is None
        admit(mine, "late", Role.WORKER, (), 1, datetime.now(UTC))
        until(lambda: ask_hello(hub, mine, "late"))


def ask_hello(hub: Coordinator, pki: Path, name: str) -> bool:
    try:
        with WireWorker(hub.endpoints, hub.run, name, files_of(pki, name)) as worker:
            return isinstance(worker.hello(product_version()), HelloReply)
    except zenoh.ZError:
        return False


def test_the_job_of_a_revoked_host_is_reassigned_and_its_bundle_is_refused(pki, tmp_path):
    mine = tmp_path / "pki"
    shutil.copytree(pki, mine)
    with (
        opened_at(tmp_path, mine, lease_ttl_s=5.0) as hub,
        WireWorker(hub.endpoints, hub.run, "node", files_of(mine, "node")) as bad,
        WireWorker(hub.endpoints, hub.run, "other", files_of(mine, "other")) as good,
    ):
        bad.hello(product_version())
        job, lease = bad.job()
        revoke(mine, "node")
        until(lambda: bad.hello(product_version()) is None)
        assert not bad.deliver(lease, bundle_for(job))
        until(lambda: good.hello(product_version()) is not None)
        done = set()
        while len(done) < 2:
            given, under = good.job()
            assert good.deliver(under, bundle_for(given))
            done.add(given.index)
            until(lambda: hub.progress().jobs.get("archived") == len(done))  # no lease expires while a bundle waits
        until(hub.is_finished)
        assert job.index in done
        assert hub.progress().jobs["archived"] == 2
