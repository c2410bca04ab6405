"""The hostile clients of the benchmark report a connection reset at any moment; a flood continues after resets."""

from __future__ import annotations

import contextlib
import socket
import struct
import threading

import pytest

from tests.benchmarks.attack import flood, read_to_the_end

RESET_ON_CLOSE = struct.pack("ii", 1, 0)


def reset(connection: socket.socket) -> None:
    connection.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, RESET_ON_CLOSE)
    connection.close()


def test_a_reset_before_the_end_of_the_requests_is_a_connection_error():
    with socket.create_server(("127.0.0.1", 0)) as server, socket.create_connection(server.getsockname()) as tab:
        reset(server.accept()[0])
        with pytest.raises(ConnectionResetError):
            tab.recv(1)  # waits for the reset and consumes its error
        with pytest.raises(ConnectionResetError):
            read_to_the_end(tab)


def test_a_flood_continues_after_resets():
    with socket.create_server(("127.0.0.1", 0)) as server:
        server.settimeout(0.05)
        name, port = server.getsockname()
        attack = threading.Thread(target=flood, args=(f"{name}:{port}", 500))
        attack.start()
        while attack.is_alive():
            with contextlib.suppress(TimeoutError):
                reset(server.accept()[0])
