"""Builds the bundles for the processes of `light_simulation` in one process. Equal orders give equal bundles."""

from __future__ import annotations

import secrets
import socketserver
import threading

from schemas.support.closing import Closing
from tests.builders.bundle import parts_for
from workers.process.messages import SimulationOrder


class _Handler(socketserver.StreamRequestHandler):
    def handle(self) -> None:
        line = self.rfile.readline()
        if not line:
            return
        order = SimulationOrder.model_validate_json(line)
        parts = parts_for(order.job)
        worker = parts.meta.provenance.model_copy(update={"worker": order.sid})
        self.wfile.write(parts.with_meta(provenance=worker).write())


class _Server(socketserver.ThreadingUnixStreamServer):
    daemon_threads = True

    def handle_error(self, request: object, client_address: object) -> None:
        """Ignores errors, because a simulation may be killed during its request."""


class BundleMaker(Closing):
    """Serves a Unix socket: a client sends an order as one line of JSON and gets its bundle. Context manager."""

    def __init__(self) -> None:
        self.name = f"minivla-{secrets.token_hex(8)}"
        """Name of the socket in the abstract namespace."""
        self._server = _Server(f"\0{self.name}", _Handler)
        self._thread = threading.Thread(target=self._server.serve_forever, args=(0.1,), name="bundle-maker")
        self._thread.start()

    def close(self) -> None:
        """Ends the server."""
        self._server.shutdown()
        self._server.server_close()
        self._thread.join()
