"""Reserves loopback addresses for servers that tests restart at the same address. Starts no server."""

from __future__ import annotations

import itertools
import os
import socket
from collections import deque
from pathlib import Path

_LOWEST_OUTGOING = int(Path("/proc/sys/net/ipv4/ip_local_port_range").read_text().split()[0])
_PORTS = itertools.cycle(range(max(_LOWEST_OUTGOING, 20_000) - 2 - os.getpid() % 8000, 10_000, -1))
"""Ports below the range of outgoing connections, so no connection takes the port of a server that restarts."""
_RESERVED = deque[int]()
_MOST_RESERVED = 256


def free_endpoint() -> str:
    """Returns an unused zenoh endpoint on loopback; see `free_port`."""
    return f"tcp/127.0.0.1:{free_port()}"


def free_port() -> int:
    """Returns an unused port of 127.0.0.1 that no other test process gets from this function.

    The reservation is a socket in the abstract namespace. It ends when this process ends, or after this process has
    reserved 256 more ports.
    """
    for port in _PORTS:
        with socket.socket() as probe:
            mark = socket.socket(socket.AF_UNIX)
            try:
                mark.bind(f"\0minivla-test-port-{port}")
                probe.bind(("127.0.0.1", port))
            except OSError:
                mark.close()
                continue
        _RESERVED.append(mark.detach())
        if len(_RESERVED) > _MOST_RESERVED:
            os.close(_RESERVED.popleft())
        return port
    raise AssertionError("itertools.cycle ended")
