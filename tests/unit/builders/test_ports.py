"""Test processes that run in parallel get different ports."""

from __future__ import annotations

import socket
import subprocess
import sys
from pathlib import Path

from tests.builders.ports import free_endpoint, free_port

ROOT = Path(__file__).parents[3]
_TAKES_THREE = """
import os, sys
os.getpid = lambda: int(sys.argv[1])  # the same first port as here
from tests.builders.ports import free_port
print(*(free_port() for _ in range(3)), flush=True)
sys.stdin.read()
"""


def test_processes_that_search_from_the_same_first_port_get_different_ports():
    words = [sys.executable, "-c", _TAKES_THREE, "1234"]
    children = [
        subprocess.Popen(words, cwd=ROOT, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) for _ in range(2)
    ]
    try:
        ports = [int(word) for child in children for word in child.stdout.readline().split()]
    finally:
        for child in children:
            child.communicate()
    assert len(set(ports)) == 6


def test_a_port_is_free_and_returned_once():
    ports = [free_port() for _ in range(20)]
    assert len(set(ports)) == 20
    for port in ports:
        with socket.socket() as server:
            server.bind(("127.0.0.1", port))
    assert free_endpoint().startswith("tcp/127.0.0.1:")
