"""Connections without a handshake: closed quickly, and other clients can connect."""

from __future__ import annotations

import resource
import socket
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path

import pytest
import zenoh

from coordinator.protocol.node import ZenohNode
from coordinator.protocol.zenoh_config import client_config, router_config
from schemas.protocol.identity import Role, TlsFiles
from tests.builders.keys import files_of, make_authority

IDLE = 1500
LEASE_S = 4.0
SOON_S = 8.0


@contextmanager
def listening(scheme: str, tls: TlsFiles | None = None, admitted: dict[str, Role] | None = None) -> Iterator[ZenohNode]:
    endpoint = (f"{scheme}/127.0.0.1:0",)
    with ZenohNode(endpoint, lambda ends, who: router_config(ends, LEASE_S, tls, who), lambda: admitted or {}) as node:
        yield node


def connect(node: ZenohNode, tls: TlsFiles | None = None) -> None:
    """Opens and closes a session; raises if it takes more than two seconds."""
    zenoh.open(client_config(node.endpoints, LEASE_S, tls)).close()


def idle(node: ZenohNode, stack: ExitStack) -> socket.socket:
    port = int(node.endpoints[0].rpartition(":")[2])
    return stack.enter_context(socket.create_connection(("127.0.0.1", port), timeout=SOON_S))


def test_a_client_can_connect_while_many_other_connections_are_idle() -> None:
    if resource.getrlimit(resource.RLIMIT_NOFILE)[1] < 2 * IDLE + 500:
        pytest.skip("the limit of open files is too low for so many connections")
    with listening("tcp") as node, ExitStack() as stack:
        for _ in range(IDLE):
            idle(node, stack)
        connect(node)
        connect(node)


@pytest.mark.parametrize("scheme", ["tcp", "tls"])
@pytest.mark.parametrize("said", [b"", b"\x16\x03\x01"], ids=["silent", "three bytes"])
def test_a_connection_without_a_handshake_is_closed(scheme: str, said: bytes, tmp_path: Path) -> None:
    authority = make_authority(tmp_path / "pki", workers=["node"])
    tls = files_of(authority, "hub") if scheme == "tls" else None
    with listening(scheme, tls, {"node": Role.WORKER}) as node, ExitStack() as stack:
        silent = idle(node, stack)
        silent.sendall(said)
        with suppress(ConnectionResetError):
            assert silent.recv(1) in {b"", b"\x15"}  # end of stream, possibly after a TLS alert
        connect(node, files_of(authority, "node") if tls else None)
