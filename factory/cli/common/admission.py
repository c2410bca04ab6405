"""Where a verb lets workers in: without TLS on loopback only, with it whoever the list of hosts admits."""

from __future__ import annotations

from pathlib import Path

from coordinator.options import DEFAULT_LISTEN
from coordinator.protocol.tls import Guard
from factory.support.listen import require_loopback, require_tls_endpoints

__all__ = ["open_door"]

_TLS_LISTEN = ("tls/0.0.0.0:7447",)


def open_door(tls: Path | None, listen: tuple[str, ...]) -> tuple[Guard | None, tuple[str, ...]]:
    """Returns who is let in, and where.

    Args:
        tls: folder of certificates, if any.
        listen: endpoints as asked for; none takes the default.

    Raises:
        UsageError: an endpoint and the certificates do not go together.
    """
    if tls is None:
        require_loopback(listen)
        return None, listen or DEFAULT_LISTEN
    require_tls_endpoints(listen)
    return Guard(tls), listen or _TLS_LISTEN
