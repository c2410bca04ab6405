"""Which endpoints may be used: without TLS loopback and nothing else, with it TLS and nothing else. Pure."""

from __future__ import annotations

import ipaddress
from collections.abc import Sequence

from schemas.errors import UsageError

__all__ = ["require_endpoints", "require_loopback", "require_tls_endpoints"]


def require_loopback(endpoints: Sequence[str]) -> None:
    """Makes sure that every endpoint is of the form tcp/HOST:PORT with a loopback HOST.

    Raises:
        UsageError: an endpoint is malformed, or reachable from other machines.
    """
    for endpoint in endpoints:
        host = _host_of(endpoint, "tcp")
        if host != "localhost" and not _is_loopback(host):
            raise UsageError(
                f"{endpoint} is reachable from other machines: without --tls, only loopback addresses are allowed. "
                "Create "
                "certificates with `factory keys` and listen on tls/HOST:PORT, or stay on tcp/127.0.0.1:PORT"
            )


def require_endpoints(endpoints: Sequence[str], *, with_tls: bool) -> None:
    """Makes sure that endpoints to connect to are of the form tcp/HOST:PORT, with certificates tls/HOST:PORT.

    Raises:
        UsageError: an endpoint is malformed, or does not go with the certificates.
    """
    for endpoint in endpoints:
        _host_of(endpoint, "tls" if with_tls else "tcp")


def require_tls_endpoints(endpoints: Sequence[str]) -> None:
    """Makes sure that every endpoint is of the form tls/HOST:PORT.

    Raises:
        UsageError: an endpoint is malformed, or would not be encrypted.
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
