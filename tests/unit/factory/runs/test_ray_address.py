"""Addresses of Ray clusters that are checked before Ray is started."""

from __future__ import annotations

import socket

import pytest

from factory.runs.ray_engine import require_reachable
from schemas.errors import UsageError


@pytest.mark.parametrize(
    "address", ["", "10.0.0.1", ":6379", "10.0.0.1:", "10.0.0.1:0", "10.0.0.1:65536", "h:٣٣", "ray://h"]
)
def test_an_address_without_host_or_port_is_refused(address: str) -> None:
    with pytest.raises(UsageError, match=r"is not the address of a Ray cluster; example: 10\.0\.0\.1:6379"):
        require_reachable(address)


@pytest.mark.parametrize("scheme", ["", "ray://"])
def test_an_address_where_no_server_runs_is_refused(scheme: str) -> None:
    with socket.socket() as bound:
        bound.bind(("127.0.0.1", 0))
        port = bound.getsockname()[1]
        with pytest.raises(UsageError, match=rf"no Ray cluster at {scheme}127.0.0.1:{port}: .* refuses connections"):
            require_reachable(f"{scheme}127.0.0.1:{port}")


@pytest.mark.parametrize("address", [None, "auto", "local"])
def test_an_address_without_a_host_is_not_checked(address: str | None) -> None:
    require_reachable(address)


def test_an_address_with_a_server_is_accepted() -> None:
    with socket.create_server(("127.0.0.1", 0)) as server:
        require_reachable(f"127.0.0.1:{server.getsockname()[1]}")
