"""Where the status pages may be served, and under which names: loopback by itself, elsewhere only behind a token."""

from __future__ import annotations

import ipaddress
import socket
from typing import NamedTuple
from urllib.parse import urlsplit

from schemas.errors import UsageError

__all__ = ["HttpAddress", "is_own_name", "parse_address"]

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
        raise UsageError(f"{text!r} is not HOST:PORT; example: 127.0.0.1:9464")
    host = host.strip("[]") or "0.0.0.0"  # noqa: S104 - asked for, and only behind a token
    if token is not None and len(token) < _MIN_TOKEN:
        raise UsageError(
            f"the token has {len(token)} characters, at least {_MIN_TOKEN} are required; create one with: openssl "
            "rand -hex 16"
        )
    if token is None and not _is_loopback(host):
        raise UsageError(
            f"{text} is reachable from other machines: serve status pages on 127.0.0.1:PORT, or protect them with "
            "--http-token FILE"
        )
    return HttpAddress(host, int(port))


def is_own_name(host: str, address: HttpAddress) -> bool:
    """Returns whether a request's `Host` names this server: by a loopback name, or by the address it was given.

    Where it listens on every address of this machine, each numeric address and the machine's own name are meant too. A
    web page that has its name point here (DNS rebinding) is asked for by that name.

    Args:
        host: the header's value, with or without a port.
        address: as configured.
    """
    try:
        name = (urlsplit(f"//{host}").hostname or "").rstrip(".").lower()
    except ValueError:
        return False
    if _is_loopback(name) or name == address.host.lower():
        return True
    return _is_any(address.host) and (_is_numeric(name) or name == socket.gethostname().lower())


def _is_any(host: str) -> bool:
    return _is_numeric(host) and ipaddress.ip_address(host).is_unspecified


def _is_numeric(host: str) -> bool:
    try:
        ipaddress.ip_address(host)
    except ValueError:
        return False
    return True


def _is_loopback(host: str) -> bool:
    if host == "localhost":
        return True
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return False
