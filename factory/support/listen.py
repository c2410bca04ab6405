"""Endpoints and access control of commands that listen: only loopback without TLS, only admitted hosts with TLS.

Opens no socket.
"""

from __future__ import annotations

import importlib.util
import socket
from collections.abc import Sequence
from pathlib import Path

from coordinator.options import DEFAULT_LISTEN
from coordinator.protocol.tls import Guard
from factory.keys.authority import addresses_of
from schemas.errors import UsageError
from schemas.protocol.address_file import is_loopback_name
from schemas.protocol.reachability import split_endpoint

_TLS_LISTEN = ("tls/0.0.0.0:7447",)


def require_loopback(endpoints: Sequence[str]) -> None:
    """Raises an error unless every endpoint has the form tcp/HOST:PORT with a loopback HOST.

    Raises:
        UsageError: An endpoint is malformed, or is reachable from other machines.
    """
    for endpoint in endpoints:
        host = _host_of(endpoint, "tcp")
        if not is_loopback_name(host):
            raise UsageError(
                f"{endpoint} is reachable from other machines: without --tls, only loopback addresses are allowed. "
                "Create certificates with `factory keys` and listen on tls/HOST:PORT, or stay on tcp/127.0.0.1:PORT"
            )


def require_endpoints(endpoints: Sequence[str], *, with_tls: bool) -> None:
    """Raises an error unless every endpoint is @FILE or has the form tcp/HOST:PORT, or tls/HOST:PORT if `with_tls`.

    Raises:
        UsageError: An endpoint is malformed, or its protocol does not match `with_tls`.
    """
    for endpoint in endpoints:
        if not endpoint.startswith("@"):
            _host_of(endpoint, "tls" if with_tls else "tcp")


def require_tls_endpoints(endpoints: Sequence[str]) -> None:
    """Raises an error unless every endpoint has the form tls/HOST:PORT.

    Raises:
        UsageError: An endpoint is malformed, or its protocol is not encrypted.
    """
    for endpoint in endpoints:
        _host_of(endpoint, "tls")


def choose_listening(tls: Path | None, listen: tuple[str, ...]) -> tuple[Guard | None, tuple[str, ...]]:
    """Returns the access control (`None` without TLS) and the endpoints to listen on.

    Args:
        tls: TLS folder of this host, or `None`.
        listen: endpoints given by the user; when empty, the default endpoint is used.

    Raises:
        UsageError: without TLS, an endpoint is not on loopback; with TLS, an endpoint does not begin with `tls/`.
    """
    if tls is None:
        require_loopback(listen)
        return None, listen or DEFAULT_LISTEN
    require_tls_endpoints(listen)
    return Guard(tls), listen or _TLS_LISTEN


def find_hosts(guard: Guard) -> tuple[str, ...]:
    """Returns the names and addresses of the certificate; empty if `cryptography` is not installed to read it."""
    if importlib.util.find_spec("cryptography") is None:
        return ()
    return addresses_of(guard.files.certificate.read_bytes())


def split_resolvable(endpoints: Sequence[str]) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Returns the endpoints whose host this machine can resolve, and the others."""
    usable, unknown = [], []
    for endpoint in endpoints:
        try:
            socket.getaddrinfo(split_endpoint(endpoint)[1], None)
            usable.append(endpoint)
        except OSError:
            unknown.append(endpoint)
    return tuple(usable), tuple(unknown)


def _host_of(endpoint: str, wanted: str) -> str:
    protocol, _, address = endpoint.partition("/")
    host, _, port = address.rpartition(":")
    if protocol in {"tcp", "tls"} and protocol != wanted:
        remedy = f"write tls/{address}, or remove --tls" if wanted == "tls" else "give the TLS folder with --tls"
        raise UsageError(f"{endpoint} and {'--tls' if wanted == 'tls' else 'no --tls'} cannot be combined: {remedy}")
    if protocol != wanted or not host or not port.isdigit() or int(port) > 65535:
        raise UsageError(f"{endpoint!r} is not a valid endpoint; example: {wanted}/127.0.0.1:7447")
    return host.strip("[]")
