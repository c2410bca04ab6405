"""Serves the status pages with tornado in one thread, with limits on connections and their duration.

The server accepts GET and HEAD only, and only for the names of this machine, to prevent DNS rebinding. Tornado supports
a deadline for a whole request; other servers limit the pause between two bytes. No other module uses tornado. An
address that other machines can reach requires a token.
"""

from __future__ import annotations

import asyncio
import ipaddress
import socket
import threading
from concurrent.futures import ThreadPoolExecutor
from http import HTTPStatus
from typing import NamedTuple
from urllib.parse import urlsplit

import structlog
from tornado.httpserver import HTTPServer
from tornado.iostream import IOStream
from tornado.web import Application, RequestHandler

from coordinator.status.health import StatusSource
from coordinator.status.pages import Pages, plain_page
from schemas.errors import UsageError, WorldError
from schemas.support.closing import Closing

_MIN_TOKEN = 16
_REQUEST_S = 5.0
"""Timeout for receiving a whole request, seconds."""
_CONNECTION_S = 15.0
"""Timeout of a connection, seconds; reading a slow ledger takes up to 5 s."""
_MOST_CONNECTIONS = 256
"""Maximum number of connections; beyond it the oldest is closed. A normal request completes within milliseconds."""
_MOST_HEADER_BYTES = 16 << 10
_THREADS = 8
log = structlog.get_logger(__name__)


class HttpAddress(NamedTuple):
    """Host and port of the status pages; port 0 selects a free port."""

    host: str
    """Host name or address."""
    port: int
    """TCP port."""


def parse_address(text: str, token: str | None) -> HttpAddress:
    """Parses HOST:PORT.

    Args:
        text: address such as `127.0.0.1:9464`, `[::1]:9464` or `:9464`, which is every address of this machine.
        token: token that `/metrics` requires; `None` allows loopback only.

    Raises:
        UsageError: the address is malformed, other machines can reach it without a token, or the token is too short.
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
    if token is None and not _is_loopback(host):
        raise UsageError(
            f"{text} is reachable from other machines: serve status pages on 127.0.0.1:PORT, or protect them with "
            "--http-token FILE"
        )
    return HttpAddress(host, int(port))


def is_own_name(host: str, address: HttpAddress) -> bool:
    """Returns whether the `Host` header of a request names this server by a loopback name or its configured address.

    If the server listens on every address of this machine, each numeric address and the machine's host name match too.
    The check prevents DNS rebinding: the requests of a web page whose name resolves to this machine carry that name.

    Args:
        host: value of the header, with or without a port.
        address: configured address.
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


class StatusServer(Closing):
    """Running HTTP server; a context manager.

    Args:
        address: address to listen on.
        source: health and metrics of a coordinator or gateway.
        token: token that `/metrics` requires as `Authorization: Bearer TOKEN`; `None` requires none.

    Raises:
        WorldError: the address is in use.
        UsageError: the extra `metrics` is not installed.
    """

    def __init__(self, address: HttpAddress, source: StatusSource, token: str | None = None) -> None:
        pages = Pages(source, token)
        try:
            family = socket.AF_INET6 if ":" in address.host else socket.AF_INET
            listening = socket.create_server((address.host, address.port), family=family)
        except OSError as error:
            raise WorldError(
                f"cannot serve status pages on {address.host}:{address.port}: {error.strerror or error}; give another "
                "address with --http"
            ) from error
        listening.setblocking(False)
        host, port = listening.getsockname()[:2]
        self.url = f"http://{f'[{host}]' if ':' in host else host}:{port}"
        """URL of the server."""
        self._loop = asyncio.new_event_loop()
        self._closing = asyncio.Event()
        serve = self._serve(listening, address, pages)
        self._thread = threading.Thread(target=self._loop.run_until_complete, args=(serve,), name="http")
        self._thread.start()

    def close(self) -> None:
        """Stops listening and closes all connections."""
        self._loop.call_soon_threadsafe(self._closing.set)
        self._thread.join()
        self._loop.close()

    async def _serve(self, listening: socket.socket, address: HttpAddress, pages: Pages) -> None:
        threads = ThreadPoolExecutor(_THREADS, thread_name_prefix="http-page")
        settings = {"pages": pages, "threads": threads, "address": address}
        server = _Server(
            Application([(".*", _Handler, settings)], log_function=_log_request),
            no_keep_alive=True,
            idle_connection_timeout=_REQUEST_S,
            body_timeout=_REQUEST_S,
            max_header_size=_MOST_HEADER_BYTES,
            max_body_size=_MOST_HEADER_BYTES,
        )
        server.add_socket(listening)
        await self._closing.wait()
        server.stop()
        await server.close_all_connections()
        threads.shutdown(wait=False, cancel_futures=True)


class _Server(HTTPServer):
    """HTTP server that limits the number of connections and their duration."""

    def initialize(self, *args: object, **kwargs: object) -> None:
        super().initialize(*args, **kwargs)  # type: ignore[arg-type]
        self._streams: list[IOStream] = []

    def handle_stream(self, stream: IOStream, address: tuple[str, int]) -> None:
        self._streams = [other for other in self._streams if not other.closed()]
        if len(self._streams) >= _MOST_CONNECTIONS:
            self._streams.pop(0).close()
        self._streams.append(stream)
        asyncio.get_running_loop().call_later(_CONNECTION_S, stream.close)
        super().handle_stream(stream, address)


class _Handler(RequestHandler):
    """Request handler of the status pages."""

    def initialize(self, pages: Pages, threads: ThreadPoolExecutor, address: HttpAddress) -> None:
        self._pages, self._threads, self._address = pages, threads, address

    def set_default_headers(self) -> None:
        self.set_header("Server", "minivla-factory")

    async def get(self) -> None:
        host = self.request.headers.get("Host")
        if host is not None and not is_own_name(host, self._address):
            status, kind, body = plain_page(
                HTTPStatus.MISDIRECTED_REQUEST, f"not served as {host[:80]}: ask by the address"
            )
        else:
            status, kind, body = await self._answer()
        self.set_status(status)
        self.set_header("Content-Type", kind)
        if status is HTTPStatus.UNAUTHORIZED:
            self.set_header("WWW-Authenticate", "Bearer")
        self.finish(body)

    head = get

    async def _answer(self) -> tuple[HTTPStatus, str, bytes]:
        asked = (self.request.path, self.request.headers.get("Authorization", ""))
        if self.request.path == "/healthz":
            return self._pages.answer(*asked)  # independent of threads that wait for the ledger
        try:
            return await asyncio.get_running_loop().run_in_executor(self._threads, self._pages.answer, *asked)
        except Exception:
            log.exception("status_page_failed", path=self.request.path[:80])
            return plain_page(HTTPStatus.INTERNAL_SERVER_ERROR, "failed; see the coordinator's log")

    def compute_etag(self) -> None:
        """Returns no entity tag, because the metrics change with every response."""


def _log_request(handler: RequestHandler) -> None:
    request = handler.request
    log.debug("http", status=handler.get_status(), method=request.method, uri=request.uri, client=request.remote_ip)
