"""Error messages of clients that cannot reach a coordinator, and addresses that clients read from a file."""

from __future__ import annotations

import socket
from collections.abc import Iterator
from datetime import UTC, datetime
from pathlib import Path

import pytest

from coordinator.options import CoordinatorOptions
from coordinator.protocol.ask import ask_progress
from coordinator.protocol.tls import Guard
from coordinator.service import Coordinator
from coordinator.settings import CoordinatorSettings
from factory.keys import admit
from factory.support.listen import find_hosts
from schemas.errors import RunFinished, TransientError, WorldError
from schemas.protocol.address_file import (
    ADDRESS_FILE,
    find_endpoints,
    mark_finished,
    read_address,
    usable_endpoints,
    write_address,
)
from schemas.protocol.identity import Role
from schemas.protocol.reachability import why_unreachable
from schemas.support.child import python_module
from tests.builders.keys import files_of, make_authority
from tests.builders.ledger import room_catalog, room_plan
from tests.builders.ports import free_endpoint
from tests.builders.wire_worker import until
from tests.builders.worker import WorkerThread, settings_for

SMALL = python_module("tests.builders.small_simulation", "0.0")


@pytest.fixture(scope="module")
def pki(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return make_authority(tmp_path_factory.mktemp("tls") / "pki", ("node",), ("boss",))


def opened(folder: Path, **options: object) -> Coordinator:
    settings = CoordinatorSettings(reserve_bytes=0, retry_after_s=0.1, pullers=1, lease_ttl_s=60.0)
    return Coordinator(
        folder / "out", room_plan(2), room_catalog(folder), CoordinatorOptions(settings=settings, **options)
    )


@pytest.fixture
def silent_port() -> Iterator[int]:
    with socket.create_server(("127.0.0.1", 0)) as server:
        yield server.getsockname()[1]


def test_a_refused_connection_names_the_host_and_the_port(tmp_path):
    endpoint = free_endpoint()
    port = endpoint.rpartition(":")[2]
    with pytest.raises(TransientError, match=f"host 127.0.0.1 refuses connections to port {port}"):
        ask_progress((endpoint,))
    with (
        pytest.raises(WorldError, match=f"host 127.0.0.1 refuses connections to port {port}"),
        WorkerThread(settings_for(endpoint, tmp_path, wait_s=0.0)) as worker,
    ):
        worker.join()


def test_a_host_name_that_cannot_be_resolved_is_named():
    with pytest.raises(TransientError, match=r"host hub\.invalid cannot be resolved"):
        ask_progress(("tcp/hub.invalid:7447",))


def test_a_certificate_for_another_name_is_explained(tmp_path, pki):
    with opened(tmp_path, listen=("tls/0.0.0.0:0",), guard=Guard(pki / "hub")) as hub:
        other = hub.endpoints[0].replace("0.0.0.0", "127.0.0.2")
        assert "its certificate is for another name" in why_unreachable((other,), files_of(pki, "boss"))
        own = hub.endpoints[0].replace("0.0.0.0", "127.0.0.1")
        assert why_unreachable((own,), files_of(pki, "boss")) == ""


def test_a_certificate_of_another_authority_is_explained(tmp_path, pki):
    foreign = make_authority(tmp_path / "foreign", ("node",), ("boss",))
    with opened(tmp_path, listen=("tls/127.0.0.1:0",), guard=Guard(pki / "hub")) as hub:
        cause = why_unreachable(hub.endpoints, files_of(foreign, "boss"))
    assert "its certificate is not accepted" in cause


def test_a_port_without_tls_is_explained(silent_port, pki):
    cause = why_unreachable((f"tls/127.0.0.1:{silent_port}",), files_of(pki, "boss"), timeout_s=0.2)
    assert "the TLS handshake fails" in cause


def test_wildcard_addresses_are_replaced_with_the_names_of_the_host():
    assert usable_endpoints(("tls/0.0.0.0:7447", "tls/[::]:7448"), ("hub", "fd00::1")) == (
        "tls/hub:7447",
        "tls/[fd00::1]:7447",
        "tls/hub:7448",
        "tls/[fd00::1]:7448",
    )
    assert usable_endpoints(("tcp/127.0.0.1:1", "tcp/[::1]:2"), ("hub",)) == ("tcp/127.0.0.1:1", "tcp/[::1]:2")


def test_a_coordinator_announces_the_names_of_its_certificate(tmp_path, pki):
    admit(pki, "core", Role.COORDINATOR, ("core.example.org", "10.0.0.1"), 2, datetime.now(UTC))
    guard = Guard(pki / "core")
    with opened(tmp_path, listen=("tls/0.0.0.0:0",), guard=guard, hosts=find_hosts(guard)) as hub:
        port = hub.endpoints[0].rpartition(":")[2]
        assert hub.reachable == tuple(f"tls/{name}:{port}" for name in ("core", "core.example.org", "10.0.0.1"))
        address = read_address(tmp_path / "out")
        assert address is not None
        assert address.endpoints == hub.reachable


def test_a_worker_waits_for_the_address_file_and_reads_it_again_after_a_move_of_the_coordinator(tmp_path):
    with WorkerThread(settings_for(f"@{tmp_path / 'out'}", tmp_path / "host", command=SMALL)) as worker:
        with opened(tmp_path, listen=(free_endpoint(),)) as hub:
            until(lambda: hub.progress().jobs["archived"] > 0 or bool(hub.progress().workers))
        with opened(tmp_path, listen=(free_endpoint(),)) as hub:
            until(hub.is_finished)
            hub.wait_for_workers_to_disconnect()
        assert worker.join() == 0


def test_a_worker_that_starts_after_the_end_of_the_run_ends_at_once(tmp_path):
    mark_finished(tmp_path, "run-1")
    with pytest.raises(RunFinished, match=r"run run-1 in .* is finished, and its coordinator has ended"):
        find_endpoints((f"@{tmp_path}",))
    with WorkerThread(settings_for(f"@{tmp_path}", tmp_path / "host", command=SMALL)) as worker:
        assert worker.join() == 0


def test_a_worker_that_missed_the_end_of_the_run_learns_of_the_end_from_the_address_file(tmp_path):
    with WorkerThread(settings_for(f"@{tmp_path / 'out'}", tmp_path / "host", command=SMALL)) as worker:
        with opened(tmp_path, listen=(free_endpoint(),)) as hub:
            until(lambda: bool(hub.progress().workers))
        mark_finished(tmp_path / "out", "run-1")
        assert worker.join() == 0


@pytest.mark.parametrize("text", [None, "{}", "not json"])
def test_a_file_without_an_address_is_named(tmp_path, text):
    file = tmp_path / "hub.json"
    if text is not None:
        file.write_text(text)
    with pytest.raises(WorldError, match=r"hub\.json has no address of a coordinator"):
        find_endpoints((f"@{file}",))


def test_endpoints_and_address_files_can_be_combined(tmp_path):
    write_address(tmp_path, "run-1", ("tcp/10.0.0.1:7447",))
    expected = ("tcp/10.0.0.2:7447", "tcp/10.0.0.1:7447")
    assert find_endpoints(("tcp/10.0.0.2:7447", f"@{tmp_path}")) == expected
    assert find_endpoints(("tcp/10.0.0.2:7447", f"@{tmp_path / ADDRESS_FILE}")) == expected
