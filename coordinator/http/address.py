"""Where the status pages may be served: loopback by itself, elsewhere only behind a token. Pure."""

from __future__ import annotations

import ipaddress
from typing import NamedTuple

from schemas.errors import UsageError

__all__ = ["HttpAddress", "parse_address"]

_MIN_TOKEN = 16


class HttpAddress(NamedTuple):
    """A host and a port; port 0 takes a free one."""

    host: str
    port: int


def parse_address(text: str, token: str | None) -> HttpAddress:
    """Reads HOST:PORT.

    Args:
        text: such as `127.0.0.1:9464`, `[::1]:9464` or `:9464`, which means every address of this machine.
        token: that `/metrics` will ask for; without one only loopback is allowed.

    Raises:
        UsageError: malformed, reachable from other machines without a token, or a token that can be guessed.
    """
    host, colon, port = text.rpartition(":")
    if not colon or not port.isdigit() or int(port) > 65535:
        raise UsageError(f"{text!r} is no HOST:PORT; write 127.0.0.1:9464")
    host = host.strip("[]") or "0.0.0.0"  # noqa: S104 - asked for, and only behind a token
    if token is not None and len(token) < _MIN_TOKEN:
        raise UsageError(
            f"the token has {len(token)} characters, at least {_MIN_TOKEN} are wanted: openssl rand -hex 16"
        )
    if token is None and not _is_loopback(host):
        raise UsageError(
            f"{text} could be reached from other machines: serve status pages on 127.0.0.1:PORT, or protect them with "
            "--http-token FILE"
        )
    return HttpAddress(host, int(port))


def _is_loopback(host: str) -> bool:
    if host == "localhost":
        return True
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return False
