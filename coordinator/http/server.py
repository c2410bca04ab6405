"""A small HTTP server in threads of its own: three pages, GET only, bounded in size, time and number. Writes nothing.

Health pages say one word and need no token, so that any prober may ask; figures do where a token is set.
"""

from __future__ import annotations

import hmac
import threading
from collections.abc import Callable
from http import HTTPStatus
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from socket import AF_INET, AF_INET6, socket
from typing import Any

import structlog

from coordinator.http.address import HttpAddress
from coordinator.http.exposition import Exposition
from coordinator.vitals import Watched
from schemas.closing import Closing
from schemas.errors import WorldError

__all__ = ["StatusServer"]

_PATIENCE_S = 5.0
_MOST_AT_A_TIME = 16
_INDEX = "minivla-factory: /healthz /readyz /metrics\n"
_PLAIN = "text/plain; charset=utf-8"

log = structlog.get_logger(__name__)

Page = tuple[HTTPStatus, str, bytes]


class StatusServer(Closing):
    """An open server; a context manager whose exit closes it.

    Args:
        address: where to listen.
        vitals: of the coordinator, or of a gateway.
        token: that `/metrics` asks for as `Authorization: Bearer TOKEN`; `None` asks for none.

    Raises:
        WorldError: the address is taken.
        UsageError: the extra `metrics` is not installed.
    """

    def __init__(self, address: HttpAddress, vitals: Watched, token: str | None = None) -> None:
        pages = _Pages(vitals, token)
        try:
            self._server = _Server(address, pages)
        except OSError as error:
            raise WorldError(
                f"cannot serve status pages on {address.host}:{address.port}: {error.strerror or error}; give another "
                "address with --http"
            ) from error
        self._thread = threading.Thread(target=self._server.serve_forever, name="http")
        self._thread.start()
        host, port = self._server.server_address[:2]
        shown = f"[{host!s}]" if ":" in str(host) else str(host)
        self.url = f"http://{shown}:{port}"
        """Where it listens."""

    def close(self) -> None:
        """Stops listening; answers under way are finished."""
        self._server.shutdown()
        self._thread.join()
        self._server.server_close()


class _Pages:
    """What is answered to which path."""

    def __init__(self, vitals: Watched, token: str | None) -> None:
        self._vitals = vitals
        self._token = token
        self._exposition = Exposition(vitals.snapshot)
        self._pages: dict[str, Callable[[], Page]] = {
            "/": lambda: (HTTPStatus.OK, _PLAIN, _INDEX.encode()),
            "/healthz": self._health,
            "/readyz": self._readiness,
            "/metrics": self._metrics,
        }

    def answer(self, path: str, authorization: str) -> Page:
        """Returns status, content type and body for a path."""
        page = self._pages.get(path.partition("?")[0])
        if page is None:
            return _say(HTTPStatus.NOT_FOUND, _INDEX)
        if path.startswith("/metrics") and not self._is_let_in(authorization):
            return _say(HTTPStatus.UNAUTHORIZED, "a bearer token is wanted")
        return page()

    def _is_let_in(self, authorization: str) -> bool:
        wanted = f"Bearer {self._token}".encode()
        return self._token is None or hmac.compare_digest(authorization.encode("utf-8", "replace"), wanted)

    def _health(self) -> Page:
        if self._vitals.is_alive():
            return _say(HTTPStatus.OK, "ok")
        return _say(HTTPStatus.SERVICE_UNAVAILABLE, "the thread that everything goes through has ended; restart it")

    def _readiness(self) -> Page:
        troubles = self._vitals.troubles()
        if troubles:
            return _say(HTTPStatus.SERVICE_UNAVAILABLE, "\n".join(troubles))
        return _say(HTTPStatus.OK, "ready")

    def _metrics(self) -> Page:
        return HTTPStatus.OK, self._exposition.content_type, self._exposition.page()


def _say(status: HTTPStatus, text: str) -> Page:
    return status, _PLAIN, f"{text.rstrip()}\n".encode()


class _Handler(BaseHTTPRequestHandler):
    """One connection, one answer."""

    server: _Server
    timeout = _PATIENCE_S
    server_version, sys_version = "minivla-factory", ""

    def do_GET(self) -> None:
        self._answer(with_body=True)

    def do_HEAD(self) -> None:
        self._answer(with_body=False)

    def _answer(self, *, with_body: bool) -> None:
        try:
            page = self.server.pages.answer(self.path, self.headers.get("Authorization", ""))
        except Exception:
            log.exception("status_page_failed", path=self.path[:80])
            page = _say(HTTPStatus.INTERNAL_SERVER_ERROR, "failed; the coordinator's log says more")
        status, kind, body = page
        self.send_response(status)
        self.send_header("Content-Type", kind)
        self.send_header("Content-Length", str(len(body)))
        self.send_header("Connection", "close")
        if status is HTTPStatus.UNAUTHORIZED:
            self.send_header("WWW-Authenticate", "Bearer")
        self.end_headers()
        if with_body:
            self.wfile.write(body)

    def log_message(self, format: str, *args: Any) -> None:  # noqa: A002 - the name is the base class's
        log.debug("http", line=format % args, client=self.client_address[0])


class _Server(ThreadingHTTPServer):
    """Threads that end with it, and no more than a few of them."""

    daemon_threads = True
    block_on_close = False
    request_queue_size = 32

    def __init__(self, address: HttpAddress, pages: _Pages) -> None:
        self.pages = pages
        self.address_family = AF_INET6 if ":" in address.host else AF_INET
        self._free = threading.Semaphore(_MOST_AT_A_TIME)
        super().__init__((address.host, address.port), _Handler)

    def process_request(self, request: socket | tuple[bytes, socket], client_address: Any) -> None:
        if self._free.acquire(blocking=False):
            super().process_request(request, client_address)
        else:
            self.shutdown_request(request)

    def process_request_thread(self, request: Any, client_address: Any) -> None:
        try:
            request.settimeout(_PATIENCE_S)
            super().process_request_thread(request, client_address)
        except OSError as error:
            log.debug("http_client_gone", error=str(error))
            self.shutdown_request(request)
        finally:
            self._free.release()

    def handle_error(self, request: Any, client_address: Any) -> None:  # noqa: ARG002
        log.debug("http_request_failed", client=client_address[0], exc_info=True)
