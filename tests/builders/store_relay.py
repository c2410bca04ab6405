"""Relay in front of an S3 server that refuses requests, cuts uploads, loses answers or drops conditions on demand.

Reports the stages of each request to a test, so the test can end the sender at any stage.
"""

from __future__ import annotations

import http.client
import socket
import threading
from collections.abc import Callable
from enum import StrEnum
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from types import TracebackType
from typing import Any, Self
from urllib.parse import urlsplit

_CUT_AFTER_BYTES = 64 << 10
_DENIED = (
    b'<?xml version="1.0"?><Error><Code>%s</Code><Message>no</Message>'
    b"<AWSAccessKeyId>tester</AWSAccessKeyId><StringToSign>AWS4-HMAC-SHA256 private</StringToSign></Error>"
)


class Moment(StrEnum):
    """Stage of a request."""

    STARTED = "started"  # half of the body was received, and nothing was forwarded
    PASSED_ON = "passed_on"  # the server has executed the request, and the sender has no answer
    ANSWERED = "answered"  # the sender has the answer


class StoreRelay:
    """Relays requests to a server; failures are set while it runs. Context manager."""

    def __init__(self, endpoint: str) -> None:
        self.is_denying = False
        """Answers every request with 403."""
        self.denial = "AccessDenied"
        """Error code of the 403 answers."""
        self.is_cutting = False
        """Closes the connection in the middle of every large upload and forwards no part of the upload."""
        self.cuts = 0
        """Number of interrupted uploads."""
        self.answers_to_lose = 0
        """Number of the next uploads that are executed but whose answer is dropped."""
        self.ignores_conditions = False
        """Forwards requests without their `If-` headers."""
        self.watch: Callable[[Moment, str, str], bool] = lambda _moment, _command, _path: False
        """(moment, method, path) -> whether the sender has disconnected; called in the relaying thread at each stage
        of each request. If the sender has disconnected, the rest of the request is not relayed."""
        relay = self

        class Handler(_Handler):
            target = urlsplit(endpoint)
            faults = relay

        self._server = ThreadingHTTPServer(("127.0.0.1", 0), Handler)
        self._server.daemon_threads = True
        self._thread = threading.Thread(target=self._server.serve_forever, name="store-relay")
        self.endpoint = f"http://127.0.0.1:{self._server.server_port}"

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._server.shutdown()
        self._thread.join()
        self._server.server_close()


class _Handler(BaseHTTPRequestHandler):
    protocol_version = "HTTP/1.1"
    target: Any
    faults: StoreRelay

    def _relay(self) -> None:
        faults, length = self.faults, int(self.headers.get("Content-Length") or 0)
        if self.command == "PUT" and faults.is_cutting and length > _CUT_AFTER_BYTES:
            self.rfile.read(_CUT_AFTER_BYTES)
            faults.cuts += 1
            self._hang_up()
            return
        body = self.rfile.read(length // 2)
        if self._is_over(Moment.STARTED):
            return
        body += self.rfile.read(length - length // 2)
        if faults.is_denying:
            self._answer(403, {"Content-Type": "application/xml"}, _DENIED % faults.denial.encode())
            return
        headers = {
            name: value
            for name, value in self.headers.items()
            if not (faults.ignores_conditions and name.lower().startswith("if-"))
        }
        upstream = http.client.HTTPConnection(self.target.hostname, self.target.port, timeout=60)
        upstream.request(self.command, self.path, body, headers)
        answer = upstream.getresponse()
        data = answer.read()
        upstream.close()
        if self._is_over(Moment.PASSED_ON):
            return
        if self.command == "PUT" and faults.answers_to_lose > 0:
            faults.answers_to_lose -= 1
            self._hang_up()
            return
        self._answer(answer.status, dict(answer.getheaders()), data)
        self._is_over(Moment.ANSWERED)

    def _is_over(self, moment: Moment) -> bool:
        """Reports a stage; returns whether the sender has ended."""
        is_gone = self.faults.watch(moment, self.command, self.path)
        self.close_connection = self.close_connection or is_gone
        return is_gone

    def _answer(self, status: int, headers: dict[str, str], data: bytes) -> None:
        self.send_response_only(status)
        for name, value in headers.items():
            if name.lower() not in ("content-length", "connection", "transfer-encoding"):
                self.send_header(name, value)
        self.send_header(
            "Content-Length", headers.get("Content-Length", "0") if self.command == "HEAD" else str(len(data))
        )
        self.end_headers()
        if self.command != "HEAD":
            self.wfile.write(data)

    def _hang_up(self) -> None:
        self.close_connection = True
        self.connection.shutdown(socket.SHUT_RDWR)

    do_GET = do_PUT = do_HEAD = do_DELETE = do_POST = _relay  # noqa: N815 - names required by http.server

    def log_message(self, *arguments: object) -> None:
        """Logs nothing."""
