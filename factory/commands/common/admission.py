"""Endpoints and access control of commands that listen: only loopback without TLS, only admitted hosts with TLS."""

from __future__ import annotations

import importlib.util
from pathlib import Path

from coordinator.options import DEFAULT_LISTEN
from coordinator.protocol.tls import Guard
from factory.keys.authority import addresses_of
from factory.support.listen import require_loopback, require_tls_endpoints

_TLS_LISTEN = ("tls/0.0.0.0:7447",)


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
