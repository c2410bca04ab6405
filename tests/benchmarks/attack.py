"""Sends hostile requests to a web page: floods that must not change anything, and slow clients. Measures nothing."""

from __future__ import annotations

import contextlib
import errno
import socket
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager

_TIMEOUT_S = 60.0
_BATCH = 50
"""Number of requests on one connection."""
_SLOW = (b"GET /live HTTP/1.1\r\nHost: localhost\r\n\r\n", b"GET / HT", b"POST /login HTTP/1.1\r\n")


def hostile_requests(host: str) -> tuple[bytes, ...]:
    """Returns malformed requests, and requests that the server must refuse.

    The latter have no valid token, come from another site, name a wrong host, or ask for files that are not public.
    """
    texts = (
        f"POST /operations/cancel HTTP/1.1\r\nHost: {host}\r\nContent-Length: 17\r\n\r\nall=1&confirm=1&k",
        f"POST /operations/cancel HTTP/1.1\r\nHost: {host}\r\nOrigin: http://evil.example\r\nContent-Length: 0\r\n\r\n",
        "GET /operations/cancel?all=1&confirm=1 HTTP/1.1\r\nHost: evil.example\r\n\r\n",
        f"GET /static/../../../../etc/passwd HTTP/1.1\r\nHost: {host}\r\n\r\n",
        f"GET /episodes/..%2f..%2fledger.db HTTP/1.1\r\nHost: {host}\r\n\r\n",
        f"GET /?token=wrong HTTP/1.1\r\nHost: {host}\r\n\r\n",
        "\x16\x03\x01\x02\x00\x01 no HTTP\r\n\r\n",
    )
    return tuple(text.encode("latin-1") for text in texts)


def flood(host: str, count: int, seconds: float = 0.0) -> None:
    """Sends hostile requests over consecutive connections.

    Args:
        host: HOST:PORT of the server.
        count: number of requests.
        seconds: time over which they are spread, seconds; 0 sends them as fast as the server answers.
    """
    begin_s, attacks, sent = time.monotonic(), hostile_requests(host), 0
    while sent < count:
        time.sleep(max(0.0, begin_s + seconds * sent / count - time.monotonic()))
        with contextlib.suppress(ConnectionError), _connect(host) as tab:
            part = min(_BATCH, count - sent)
            sent += part
            for number in range(part):
                tab.sendall(attacks[number % len(attacks)])
            read_to_the_end(tab)


def read_to_the_end(tab: socket.socket) -> None:
    """Closes the sending side and reads what the server still sends.

    Raises:
        ConnectionError: the server reset the connection.
        TimeoutError: the server neither sends nor closes.
    """
    try:
        tab.shutdown(socket.SHUT_WR)
    except OSError as error:
        if error.errno != errno.ENOTCONN:  # the connection was reset earlier; Python raises a plain OSError
            raise
        raise ConnectionResetError(*error.args) from error
    while tab.recv(1 << 16):
        pass


@contextmanager
def slow_clients(host: str, count: int) -> Iterator[None]:
    """Keeps connections open whose clients send half a request or never read the reply."""
    with ExitStack() as stack:
        for number in range(count):
            stack.enter_context(_connect(host)).sendall(_SLOW[number % len(_SLOW)])
        yield


def _connect(host: str) -> socket.socket:
    name, _, port = host.rpartition(":")
    return socket.create_connection((name, int(port)), timeout=_TIMEOUT_S)
