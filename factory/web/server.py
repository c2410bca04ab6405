"""Serves an ASGI application with uvicorn in one thread, with limits on connections and slow clients.

No other module uses uvicorn.
"""

from __future__ import annotations

import asyncio
import socket
import ssl
import threading
from typing import Any

import h11
import uvicorn
from anyio import open_file  # noqa: F401 - anyio imports it on first use, which is the first request for a file
from starlette.types import ASGIApp, Receive, Scope, Send
from uvicorn.protocols.http.h11_impl import H11Protocol

from coordinator.status.address import HttpAddress, listen_on, url_of
from schemas.protocol.identity import TlsFiles
from schemas.support.closing import Closing

_REQUEST_S = 5.0
"""Timeout for receiving a request with its form, seconds."""
_STALLED_S = 20.0
"""Time after which a client that reads nothing of a pending reply is disconnected, seconds."""
_MOST_CONNECTIONS = 512
_MOST_HEAD_BYTES = 16 << 10
_CLOSING = "minivla.closing"
"""Key in the scope of a request; its value is the event that `closing_of` returns."""
_CLOSE_S = 2
"""Maximum time to complete open replies when the server stops, seconds."""


class WebServer(Closing):
    """Running web server; a context manager.

    Args:
        app: application to serve.
        address: address to listen on; port 0 selects a free port.
        tls: TLS files; clients need a certificate of the same authority. `None` serves plain HTTP.

    Raises:
        WorldError: the address is in use.
    """

    def __init__(self, app: ASGIApp, address: HttpAddress, tls: TlsFiles | None = None) -> None:
        self._listening = listen_on(address, "the web page")
        self.url = url_of(self._listening, "https" if tls else "http")
        """URL of the server."""
        config = uvicorn.Config(
            self._serve(app),
            http=_DeadlineProtocol,
            ws="none",
            lifespan="off",
            loop="asyncio",
            log_config=None,
            access_log=False,
            proxy_headers=False,
            server_header=False,
            limit_concurrency=_MOST_CONNECTIONS,
            timeout_keep_alive=int(_REQUEST_S),
            timeout_graceful_shutdown=_CLOSE_S,
            h11_max_incomplete_event_size=_MOST_HEAD_BYTES,
            **_tls_options(tls),
        )
        self._server = _Server(config)
        self._thread = threading.Thread(target=self._server.run, args=([self._listening],), name="web", daemon=True)
        self._thread.start()

    def close(self) -> None:
        """Stops listening and closes all connections."""
        self._server.should_exit = True
        self._thread.join()
        self._listening.close()

    def _serve(self, app: ASGIApp) -> ASGIApp:
        """Returns an application that adds the event of `closing_of` to the scope of each request and calls `app`."""

        async def serve(scope: Scope, receive: Receive, send: Send) -> None:
            scope[_CLOSING] = self._server.closing
            await app(scope, receive, send)

        return serve


def closing_of(scope: Scope) -> asyncio.Event:
    """Returns the event that is set when the server of a request begins to close."""
    found: asyncio.Event = scope[_CLOSING]
    return found


class _Server(uvicorn.Server):
    """Server that informs the open replies when it begins to close."""

    def __init__(self, config: uvicorn.Config) -> None:
        super().__init__(config)
        self.closing = asyncio.Event()

    async def shutdown(self, sockets: list[socket.socket] | None = None) -> None:
        self.closing.set()
        await super().shutdown(sockets)


class _DeadlineProtocol(H11Protocol):
    """HTTP protocol with deadlines for receiving a request and for a client that stops reading."""

    _receiving: asyncio.TimerHandle | None = None
    _stalled: asyncio.TimerHandle | None = None

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
        super().connection_made(transport)
        self._receiving = self.loop.call_later(_REQUEST_S, transport.abort)

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
        for timer in (self._receiving, self._stalled):
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
