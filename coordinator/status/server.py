"""Serves ASGI applications with uvicorn in one thread, with limits on connections and slow clients; the status pages.

uvicorn has no deadline for receiving a request, and refuses requests while too many connections are open. Therefore
`_DeadlineProtocol` has deadlines and closes the connections of slow clients first. The status pages accept GET and HEAD
only, and only for the names of this machine, to prevent DNS rebinding. An address that other machines can reach
requires a token. No other module uses uvicorn.

Design: docs/design/program.md#one-server-for-status-pages-and-the-web-page.
"""

from __future__ import annotations

import asyncio
import socket
import ssl
import threading
from collections.abc import Awaitable, Callable, MutableMapping
from concurrent.futures import ThreadPoolExecutor
from http import HTTPStatus
from typing import Any, NamedTuple

import h11
import structlog
import uvicorn
from uvicorn.protocols.http.h11_impl import H11Protocol

from coordinator.status.address import HttpAddress, is_own_name, listen_on, url_of
from coordinator.status.health import StatusSource
from coordinator.status.pages import Page, Pages, plain_page
from schemas.protocol.identity import TlsFiles
from schemas.support.closing import Closing

_REQUEST_S = 5.0
"""Timeout for receiving a request with its form, seconds."""
_STALLED_S = 20.0
"""Time after which a client that reads nothing of a pending reply is disconnected, seconds."""
_BACKLOG = 128
"""Maximum number of connections that are accepted before the requests of others are read."""
# with the 2,048 of uvicorn, a burst of connections closes new ones before their requests are read: while 1,500 slow
# clients reconnected each second, 10 of 46 requests for /healthz were answered, and all with this number
_SLOW_S = 1.0
"""Time without a complete request after which a connection is closed before others, seconds."""
_MOST_TASKS = 1024
"""Number of running requests beyond which a request gets the status 503; those of closed connections may still run."""
_MOST_HEAD_BYTES = 16 << 10
_CLOSING = "minivla.closing"
"""Key in the scope of a request; its value is the event that `closing_of` returns."""
_CLOSE_S = 2
"""Maximum time to complete open replies when the server stops, seconds."""
_THREADS = 8

Scope = MutableMapping[str, Any]
Message = MutableMapping[str, Any]
Receive = Callable[[], Awaitable[Message]]
Send = Callable[[Message], Awaitable[None]]
AsgiApp = Callable[[Scope, Receive, Send], Awaitable[None]]
log = structlog.get_logger(__name__)


class Limits(NamedTuple):
    """Limits of the connections of a server."""

    connections: int = 512
    """Maximum number of connections; beyond it, one is closed: first the oldest one of a slow client."""
    connection_s: float | None = None
    """Timeout of a connection, seconds; `None` for none."""


_WEB_LIMITS = Limits()
_STATUS_LIMITS = Limits(connections=256, connection_s=15.0)
"""Limits of the status pages. A normal request completes within milliseconds; reading a slow ledger takes up to 5 s."""


class HttpServer(Closing):
    """Running HTTP server; a context manager.

    Args:
        app: application to serve.
        address: address to listen on; port 0 selects a free port.
        what: what is served, for the error.
        tls: TLS files; clients need a certificate of the same authority. `None` serves plain HTTP.
        limits: limits of the connections.

    Raises:
        WorldError: the address is in use.
    """

    def __init__(
        self,
        app: AsgiApp,
        address: HttpAddress,
        what: str,
        tls: TlsFiles | None = None,
        limits: Limits = _WEB_LIMITS,
    ) -> None:
        self._listening = listen_on(address, what)
        self.url = url_of(self._listening, "https" if tls else "http")
        """URL of the server."""
        config = _Config(
            self._serve(app),
            http=_DeadlineProtocol,
            ws="none",
            lifespan="off",
            loop="asyncio",
            log_config=None,
            access_log=False,
            proxy_headers=False,
            server_header=False,
            log_level="error",  # a client can cause warnings
            backlog=_BACKLOG,
            limit_concurrency=_MOST_TASKS,
            timeout_keep_alive=int(_REQUEST_S),
            timeout_graceful_shutdown=_CLOSE_S,
            h11_max_incomplete_event_size=_MOST_HEAD_BYTES,
            **_tls_options(tls),
        )
        config.limits = limits
        self._server = _Server(config)
        self._thread = threading.Thread(target=self._server.run, args=([self._listening],), name="http", daemon=True)
        self._thread.start()

    def close(self) -> None:
        """Stops listening and closes all connections."""
        self._server.should_exit = True
        self._thread.join()
        self._listening.close()

    def _serve(self, app: AsgiApp) -> AsgiApp:
        """Returns an application that adds the event of `closing_of` to the scope of each request and calls `app`."""

        async def serve(scope: Scope, receive: Receive, send: Send) -> None:
            scope[_CLOSING] = self._server.closing
            await app(scope, receive, send)

        return serve


def closing_of(scope: Scope) -> asyncio.Event:
    """Returns the event that is set when the server of a request begins to close."""
    closing: asyncio.Event = scope[_CLOSING]
    return closing


class StatusServer(HttpServer):
    """Running server of the status pages; a context manager.

    Args:
        address: address to listen on.
        source: health and metrics of a coordinator or gateway.
        token: token that `/metrics` requires as `Authorization: Bearer TOKEN`; `None` requires none.

    Raises:
        WorldError: the address is in use.
        UsageError: the extra `metrics` is not installed.
    """

    def __init__(self, address: HttpAddress, source: StatusSource, token: str | None = None) -> None:
        self._threads = ThreadPoolExecutor(_THREADS, thread_name_prefix="http-page")
        app = _StatusApp(Pages(source, token), self._threads, address)
        super().__init__(app, address, "status pages", limits=_STATUS_LIMITS)

    def close(self) -> None:
        """Stops listening and closes all connections."""
        super().close()
        self._threads.shutdown(wait=False, cancel_futures=True)


class _Config(uvicorn.Config):
    """Configuration of uvicorn with the limits that it lacks."""

    limits: Limits


class _Server(uvicorn.Server):
    """Server that informs the open replies when it begins to close."""

    def __init__(self, config: uvicorn.Config) -> None:
        super().__init__(config)
        self.closing = asyncio.Event()

    async def shutdown(self, sockets: list[socket.socket] | None = None) -> None:
        self.closing.set()
        await super().shutdown(sockets)


class _DeadlineProtocol(H11Protocol):
    """HTTP protocol with a limit on connections, and with deadlines for receiving a request and for reading a reply."""

    config: _Config
    _connected_s = 0.0
    _receiving: asyncio.TimerHandle | None = None
    _stalled: asyncio.TimerHandle | None = None
    _ending: asyncio.TimerHandle | None = None

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
        if len(self.connections) >= self.config.limits.connections:
            self._close_another()
        super().connection_made(transport)
        self._connected_s = self.loop.time()
        self._receiving = self.loop.call_later(_REQUEST_S, transport.abort)
        if self.config.limits.connection_s is not None:
            self._ending = self.loop.call_later(self.config.limits.connection_s, transport.abort)

    def _close_another(self) -> None:
        """Closes the oldest connection of a slow client; if there is none, the oldest connection."""
        others = [other for other in self.connections if isinstance(other, _DeadlineProtocol)]
        oldest = min(others, key=lambda other: (not other._is_slow(), other._connected_s))
        self.connections.discard(oldest)
        oldest.transport.abort()

    def _is_slow(self) -> bool:
        return self._receiving is not None and self._receiving.when() - self.loop.time() < _REQUEST_S - _SLOW_S

    def data_received(self, data: bytes) -> None:
        if self._receiving is None:
            self._receiving = self.loop.call_later(_REQUEST_S, self.transport.abort)
        super().data_received(data)
        if self.conn.their_state not in (h11.IDLE, h11.SEND_BODY):
            self._receiving.cancel()
            self._receiving = None

    def pause_writing(self) -> None:
        super().pause_writing()
        self._stalled = self.loop.call_later(_STALLED_S, self.transport.abort)

    def resume_writing(self) -> None:
        super().resume_writing()
        if self._stalled is not None:
            self._stalled.cancel()

    def connection_lost(self, exc: Exception | None) -> None:
        for timer in (self._receiving, self._stalled, self._ending):
            if timer is not None:
                timer.cancel()
        super().connection_lost(exc)


def _tls_options(tls: TlsFiles | None) -> dict[str, Any]:
    if tls is None:
        return {}
    return {
        "ssl_certfile": tls.certificate,
        "ssl_keyfile": tls.key,
        "ssl_ca_certs": tls.ca,
        "ssl_cert_reqs": ssl.CERT_REQUIRED,
    }


class _StatusApp:
    """ASGI application of the status pages."""

    def __init__(self, pages: Pages, threads: ThreadPoolExecutor, address: HttpAddress) -> None:
        self._pages, self._threads, self._address = pages, threads, address

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:  # noqa: ARG002 - reads no form
        status, kind, body = await self._answer(scope)
        headers = {"content-type": kind, "content-length": str(len(body)), "connection": "close"}
        headers |= {"server": "minivla-factory"}
        if status is HTTPStatus.UNAUTHORIZED:
            headers["www-authenticate"] = "Bearer"
        if status is HTTPStatus.METHOD_NOT_ALLOWED:
            headers["allow"] = "GET, HEAD"
        encoded = [(name.encode("ascii"), value.encode("latin-1")) for name, value in headers.items()]
        log.debug("http", status=int(status), method=scope["method"], path=scope["path"], client=scope["client"])
        await send({"type": "http.response.start", "status": int(status), "headers": encoded})
        await send({"type": "http.response.body", "body": body})

    async def _answer(self, scope: Scope) -> Page:
        headers = {name: value.decode("latin-1") for name, value in scope["headers"]}
        host = headers.get(b"host")
        if host is not None and not is_own_name(host, self._address):
            text = f"not served as {host[:80]}: use the address of this server, or start it with --host-name NAME"
            return plain_page(HTTPStatus.MISDIRECTED_REQUEST, text)
        if scope["method"] not in ("GET", "HEAD"):
            return plain_page(HTTPStatus.METHOD_NOT_ALLOWED, "use GET or HEAD")
        request = (scope["path"], headers.get(b"authorization", ""))
        if scope["path"] == "/healthz":
            return self._pages.answer(*request)  # independent of threads that wait for the ledger
        try:
            return await asyncio.get_running_loop().run_in_executor(self._threads, self._pages.answer, *request)
        except Exception:
            log.exception("status_page_failed", path=scope["path"][:80])
            return plain_page(HTTPStatus.INTERNAL_SERVER_ERROR, "failed; see the coordinator's log")
