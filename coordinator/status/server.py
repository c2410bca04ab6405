"""Serves the status pages with tornado in one thread, with limits on connections and their duration.

The server accepts GET and HEAD only, and only for the names of this machine, to prevent DNS rebinding. Tornado supports
a deadline for a whole request; other servers limit the pause between two bytes. No other module uses tornado. An
address that other machines can reach requires a token.
"""

from __future__ import annotations

import asyncio
import socket
import threading
from concurrent.futures import ThreadPoolExecutor
from http import HTTPStatus

import structlog
from tornado.httpserver import HTTPServer
from tornado.iostream import IOStream
from tornado.web import Application, RequestHandler

from coordinator.status.address import HttpAddress, is_own_name, listen_on, url_of
from coordinator.status.health import StatusSource
from coordinator.status.pages import Pages, plain_page
from schemas.support.closing import Closing

_REQUEST_S = 5.0
"""Timeout for receiving a whole request, seconds."""
_CONNECTION_S = 15.0
"""Timeout of a connection, seconds; reading a slow ledger takes up to 5 s."""
_MOST_CONNECTIONS = 256
"""Maximum number of connections; beyond it the oldest is closed. A normal request completes within milliseconds."""
_MOST_HEADER_BYTES = 16 << 10
_THREADS = 8
log = structlog.get_logger(__name__)


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
        listening = listen_on(address, "status pages")
        self.url = url_of(listening)
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
                HTTPStatus.MISDIRECTED_REQUEST, f"not served as {host[:80]}: use the address of this server"
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
