"""Which endpoints may be listened on without TLS: loopback, and nothing else. Pure."""

from __future__ import annotations

import ipaddress
from collections.abc import Sequence

from schemas.errors import UsageError

__all__ = ["require_loopback"]


def require_loopback(endpoints: Sequence[str]) -> None:
    """Makes sure that every endpoint is of the form tcp/HOST:PORT with a loopback HOST.

    Raises:
        UsageError: an endpoint is malformed, or reachable from other machines.
    """
    for endpoint in endpoints:
        host = _host_of(endpoint)
        if host != "localhost" and not _is_loopback(host):
            raise UsageError(
                f"{endpoint} could be reached from other machines, and this version has no TLS: listen on "
                "tcp/127.0.0.1:PORT and let other hosts in through a tunnel (ssh -N -L 7447:127.0.0.1:7447 HOST)"
            )


def _host_of(endpoint: str) -> str:
    protocol, _, address = endpoint.partition("/")
    host, _, port = address.rpartition(":")
    if protocol != "tcp" or not host or not port.isdigit() or int(port) > 65535:
        raise UsageError(f"{endpoint!r} is no endpoint; write tcp/127.0.0.1:7447")
    return host.strip("[]")


def _is_loopback(host: str) -> bool:
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return False
