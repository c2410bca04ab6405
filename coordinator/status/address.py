"""Addresses of HTTP servers: parses them, opens their sockets, and checks the host name in a request."""

from __future__ import annotations

import ipaddress
import re
import socket
from collections.abc import Sequence
from typing import NamedTuple
from urllib.parse import urlsplit

from schemas.errors import UsageError, WorldError

_MIN_TOKEN = 16
_MOST_NAME_CHARS = 253
_DNS_NAME = re.compile(
    r"[A-Za-z0-9](?:[A-Za-z0-9-]{0,61}[A-Za-z0-9])?(?:\.[A-Za-z0-9](?:[A-Za-z0-9-]{0,61}[A-Za-z0-9])?)*"
)
_NOT_IN_HOST = frozenset("@/?#")
"""Characters of a URL that are not valid in a host; `urlsplit` ignores what precedes or follows them."""


class HttpAddress(NamedTuple):
    """Host and port of the status pages; port 0 selects a free port."""

    host: str
    """Host name or address."""
    port: int
    """TCP port."""
    names: tuple[str, ...] = ()
    """Further names of the server, in lower case, such as that of an ingress or of a service."""


def parse_address(
    text: str, token: str | None, *, is_encrypted: bool = False, names: Sequence[str] = ()
) -> HttpAddress:
    """Parses HOST:PORT.

    Args:
        text: address such as `127.0.0.1:9464`, `[::1]:9464` or `:9464`; without a host, all addresses of this
            machine.
        token: token that requests require; `None` allows loopback only.
        is_encrypted: whether clients need a certificate, which allows every address without a token.
        names: further names that requests may carry in their `Host` header.

    Raises:
        UsageError: the address or a name is malformed, other machines can reach it without a token, or the token is too
            short.
    """
    host, colon, port = text.rpartition(":")
    if not colon or not port.isdigit() or int(port) > 65535:
        raise UsageError(f"{text!r} is not HOST:PORT; example: 127.0.0.1:9464")
    host = host.strip("[]") or "0.0.0.0"  # noqa: S104 - requested by the user, and requires a token
    if token is not None and len(token) < _MIN_TOKEN:
        raise UsageError(
            f"the token has {len(token)} characters, at least {_MIN_TOKEN} are required; create one with: openssl "
            "rand -hex 16"
        )
    if token is None and not is_encrypted and not _is_loopback(host):
        raise UsageError(
            f"{text} is reachable from other machines: serve on 127.0.0.1:PORT, or protect the pages with "
            "--http-token FILE"
        )
    for name in names:
        if len(name) > _MOST_NAME_CHARS or _DNS_NAME.fullmatch(name) is None:
            raise UsageError(f"--host-name {name[:80]!r} is not a host name; example: minivla.example.org")
    return HttpAddress(host, int(port), tuple(name.lower() for name in names))


def is_own_name(host: str, address: HttpAddress) -> bool:
    """Returns whether the `Host` header of a request has a loopback name, the configured address or a configured name.

    If the server listens on every address of this machine, each numeric address and the machine's host name match too.
    The check prevents DNS rebinding: the requests of a web page whose name resolves to this machine carry that name.

    Args:
        host: value of the header, with or without a port.
        address: configured address.
    """
    if not _NOT_IN_HOST.isdisjoint(host):
        return False
    try:
        name = (urlsplit(f"//{host}").hostname or "").rstrip(".").lower()
    except ValueError:
        return False
    if _is_loopback(name) or name == address.host.lower() or name in address.names:
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


def listen_on(address: HttpAddress, what: str) -> socket.socket:
    """Returns a non-blocking socket that listens on an address.

    Args:
        address: address to listen on; port 0 selects a free port.
        what: what is served, for the error.

    Raises:
        WorldError: the address is in use or is not an address of this machine.
    """
    family = socket.AF_INET6 if ":" in address.host else socket.AF_INET
    try:
        listening = socket.create_server((address.host, address.port), family=family)
    except OSError as error:
        raise WorldError(
            f"cannot serve {what} on {address.host}:{address.port}: {error.strerror or error}; give another address "
            "with --http"
        ) from error
    listening.setblocking(False)
    return listening


def url_of(listening: socket.socket, scheme: str = "http") -> str:
    host, port = listening.getsockname()[:2]
    return f"{scheme}://{f'[{host}]' if ':' in host else host}:{port}"
