"""The lock of the coordinator: checking it never blocks a coordinator."""

from __future__ import annotations

import os
import subprocess
import sys
import threading
from contextlib import closing
from pathlib import Path

import pytest

from coordinator.archive.staging import Staging, is_held
from schemas.errors import WorldError

HOLD = """
import sys
from pathlib import Path
from coordinator.archive.staging import Staging
Staging(Path(sys.argv[1]), "dataset")
print("held", flush=True)
sys.stdin.read()
"""


def test_a_directory_is_locked_until_its_coordinator_is_killed(tmp_path: Path) -> None:
    assert is_held(tmp_path) is False
    command = [sys.executable, "-c", HOLD, str(tmp_path)]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as holder:
        assert holder.stdout is not None
        assert holder.stdout.readline() == "held\n"
        assert is_held(tmp_path) is True
        with pytest.raises(WorldError, match=f"another coordinator works on dataset .pid {holder.pid}"):
            Staging(tmp_path, "dataset")
        holder.kill()
    assert is_held(tmp_path) is False


def test_checking_the_lock_never_blocks_a_coordinator(tmp_path: Path) -> None:
    Staging(tmp_path, "dataset").close()
    ended = threading.Event()

    def ask() -> None:
        while not ended.is_set():
            is_held(tmp_path)

    askers = [threading.Thread(target=ask) for _ in range(3)]
    for asker in askers:
        asker.start()
    try:
        for _ in range(200):
            with closing(Staging(tmp_path, "dataset")):
                assert is_held(tmp_path) is True
    finally:
        ended.set()
        for asker in askers:
            asker.join()


@pytest.mark.skipif(os.geteuid() == 0, reason="root may read every file")
def test_an_unreadable_lock_does_not_count_as_free(tmp_path: Path) -> None:
    Staging(tmp_path, "dataset").close()
    (tmp_path / ".lock").chmod(0)
    assert is_held(tmp_path) is None
