"""Websocket server of policies for tests, with the protocol of `factory.eval.policies.remote`, on loopback."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

from websockets.sync.server import ServerConnection, serve

from factory.eval.policies.remote import pack, unpack

Answer = Callable[[ServerConnection, dict[str, Any]], None]


@contextmanager
def policy_server(answer: Answer, greeting: bytes | str | None = pack({"name": "test"})) -> Iterator[str]:
    """Runs a websocket server on loopback that calls `answer` with the connection and each observation.

    Without a greeting, clients wait for it.
    """

    def handle(connection: ServerConnection) -> None:
        if greeting is not None:
            connection.send(greeting)
        for message in connection:
            answer(connection, unpack(message))

    with serve(handle, "127.0.0.1", 0, compression=None, max_size=None) as running:
        thread = threading.Thread(target=running.serve_forever)
        thread.start()
        try:
            yield f"ws://127.0.0.1:{running.socket.getsockname()[1]}"
        finally:
            running.shutdown()
            thread.join()
