"""The processes of a session build shared data once and wait for the builder."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from tests.builders.shared import build_once, session_folder

ROOT = Path(__file__).parents[3]
_BUILDS = """
import os, sys, time
from pathlib import Path
from tests.builders.shared import build_once

def build(folder):
    folder.mkdir()
    (folder / f"by-{os.getpid()}").touch()
    time.sleep(0.2)
    (folder / "whole").touch()

print(sorted(path.name for path in build_once(Path(sys.argv[1]), build).iterdir()))
"""


def test_concurrent_processes_get_one_complete_build(tmp_path):
    words = [sys.executable, "-c", _BUILDS, tmp_path / "thing"]
    children = [subprocess.Popen(words, cwd=ROOT, stdout=subprocess.PIPE, text=True) for _ in range(3)]
    found = {child.communicate()[0] for child in children}
    assert len(found) == 1
    assert "whole" in found.pop()
    assert len(list((tmp_path / "thing").glob("by-*"))) == 1


def test_a_failed_build_is_repeated(tmp_path):
    def fail(folder: Path) -> None:
        folder.mkdir()
        (folder / "half").touch()
        raise OSError("disk full")

    with pytest.raises(OSError, match="disk full"):
        build_once(tmp_path / "thing", fail)
    assert list(build_once(tmp_path / "thing", Path.mkdir).iterdir()) == []


def test_workers_of_a_session_share_one_folder(tmp_path, monkeypatch):
    monkeypatch.setenv("PYTEST_XDIST_WORKER", "gw0")
    for name in ("popen-gw0", "popen-gw1"):
        (tmp_path / name).mkdir()
    assert session_folder(tmp_path / "popen-gw0") == session_folder(tmp_path / "popen-gw1") == tmp_path / "shared"
    monkeypatch.delenv("PYTEST_XDIST_WORKER")
    assert session_folder(tmp_path / "popen-gw0") == tmp_path / "popen-gw0" / "shared"
