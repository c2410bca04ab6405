"""A fault counts only when it has an observed effect."""

from __future__ import annotations

import os
import socket
import subprocess
import sys
from pathlib import Path

import pytest

from tests.chaos.disk import Disk
from tests.chaos.tally import Tally
from tests.chaos.wire import Wires

_WRITES = """
import os, sys
with open(sys.argv[1], "wb", buffering=0) as file:
    try:
        file.write(bytes(1 << 20))
        os.fsync(file.fileno())
    except OSError as error:
        print(error.errno)
"""


def _write(disk: Disk) -> str:
    command = [sys.executable, "-c", _WRITES, str(disk.path / "file")]
    environment = os.environ | disk.preload | disk.environment
    return subprocess.run(command, env=environment, check=True, capture_output=True, text=True).stdout.strip()


@pytest.mark.parametrize("fault", ["full disk", "slow disk"])
def test_a_disk_fault_has_an_effect_only_on_processes_that_write(fault: str, tmp_path: Path):
    with Disk(tmp_path, 4) as disk:
        if fault in disk.missing:
            pytest.skip(disk.missing[fault])

        def inject():
            return disk.fill() if fault == "full disk" else disk.slow(20)

        idle = inject()
        assert inject() is None
        disk.clear()
        busy = inject()
        refused = _write(disk)
        disk.clear()
        assert (idle.effects, busy.effects > 0) == (0, True)
        assert bool(refused) == (fault == "full disk")
        assert _write(disk) == ""
        assert busy.effects == 1


class _Echo:
    """A server, and a worker that is connected to it through a wire."""

    def __init__(self) -> None:
        self.server = socket.create_server(("127.0.0.1", 0))
        self.wires = Wires([[f"tcp/127.0.0.1:{self.server.getsockname()[1]}"]])

    def connect(self) -> tuple[socket.socket, socket.socket]:
        host, _, port = self.wires.endpoints[0][0].removeprefix("tcp/").rpartition(":")
        near = socket.create_connection((host, int(port)), timeout=60)
        far, _ = self.server.accept()
        near.sendall(b"hello")
        assert far.recv(100) == b"hello"
        return near, far

    def __enter__(self) -> _Echo:
        return self

    def __exit__(self, *_: object) -> None:
        self.wires.close()
        self.server.close()


def test_a_wire_is_cut_only_while_a_peer_is_connected():
    with _Echo() as echo:
        assert echo.wires.cut(0, 0.0) is None
        near, far = echo.connect()
        with near, far:
            span = echo.wires.cut(0, 0.0)
            assert span is not None
            assert span.effects == 2  # both ends of the relayed connection are closed
            with pytest.raises(ConnectionError):
                near.recv(100)


@pytest.mark.parametrize(("answer", "effects"), [(b"x" * 100, 1), (b"\x01\x00\x04", 0)])
def test_lost_answers_are_effects_of_a_fault_and_lost_keep_alives_are_not(answer: bytes, effects: int):
    with _Echo() as echo:
        near, far = echo.connect()
        with near, far:
            span = echo.wires.mute(0, 1.0)
            assert span is not None
            assert echo.wires.mute(0, 1.0) is None
            far.sendall(answer)
            with pytest.raises(ConnectionError):  # the connection is reset when the wire is restored
                near.recv(100)
            assert span.effects == effects


def test_tallies_are_added_and_read_back_from_their_file(tmp_path: Path):
    one, path = Tally(episodes=2, violations=["torn"], seconds=3.0), tmp_path / "tally.json"
    one.faults["link reset"] += 2
    both = Tally.load(path)
    for _ in range(2):
        both.add(one)
    both.save(path)
    assert Tally.load(path) == both
    assert (both.faults.total(), both.episodes, len(both.violations)) == (4, 4, 2)
