"""Validates zenoh endpoints: without TLS only loopback, with TLS only `tls/`. Pure functions; opens no socket."""

from __future__ import annotations

import ipaddress
from collections.abc import Sequence

from schemas.errors import UsageError


def require_loopback(endpoints: Sequence[str]) -> None:
    """Raises an error unless every endpoint has the form tcp/HOST:PORT with a loopback HOST.

    Raises:
        UsageError: An endpoint is malformed, or is reachable from other machines.
    """
    for endpoint in endpoints:
        host = _host_of(endpoint, "tcp")
        if host != "localhost" and not _is_loopback(host):
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


def _host_of(endpoint: str, wanted: str) -> str:
    protocol, _, address = endpoint.partition("/")
    host, _, port = address.rpartition(":")
    if protocol in {"tcp", "tls"} and protocol != wanted:
        remedy = f"write tls/{address}, or remove --tls" if wanted == "tls" else "give the TLS folder with --tls"
        raise UsageError(f"{endpoint} and {'--tls' if wanted == 'tls' else 'no --tls'} cannot be combined: {remedy}")
    if protocol != wanted or not host or not port.isdigit() or int(port) > 65535:
        raise UsageError(f"{endpoint!r} is not a valid endpoint; example: {wanted}/127.0.0.1:7447")
    return host.strip("[]")


def _is_loopback(host: str) -> bool:
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return False
