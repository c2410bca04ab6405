"""Private folders of the Ray engine: keys and spools of killed processes are removed by the next start."""

from __future__ import annotations

import os
import signal
import stat
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from factory.runs.ray_worker import PREFIX, RayWorker, Scratch, memory_folder, remove_stale
from schemas.errors import WorldError

HOLDER = """
import sys, time
from pathlib import Path
from factory.runs.ray_worker import Scratch
with Scratch(sys.argv[1], Path(sys.argv[2])) as scratch:
    (scratch.path / "ca.key").write_text("secret")
    print("up", flush=True)
    time.sleep(600)
"""


@contextmanager
def holder(name: str, base: Path) -> Iterator[subprocess.Popen[str]]:
    """Runs a process that uses a folder with a key."""
    command = [sys.executable, "-c", HOLDER, name, str(base)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        try:
            assert process.stdout is not None
            assert process.stdout.readline() == "up\n"
            yield process
        finally:
            process.kill()


def test_the_key_of_a_killed_process_is_removed_by_the_next_start_and_that_of_a_living_one_is_kept(tmp_path):
    with holder(f"{PREFIX}one", tmp_path) as killed, holder(f"{PREFIX}two", tmp_path):
        assert (tmp_path / f"{PREFIX}one" / "ca.key").exists()
        assert remove_stale(tmp_path) == []
        killed.send_signal(signal.SIGKILL)
        killed.wait(30)
        with Scratch(f"{PREFIX}three", tmp_path) as third:
            assert sorted(path.name for path in tmp_path.iterdir()) == [f"{PREFIX}three", f"{PREFIX}two"]
            assert stat.S_IMODE(third.path.stat().st_mode) == 0o700
            assert (tmp_path / f"{PREFIX}two" / "ca.key").exists()
        assert not third.path.exists()


def test_a_restarted_process_takes_over_its_folder_with_the_spool(tmp_path):
    with holder(f"{PREFIX}one", tmp_path) as killed:
        killed.send_signal(signal.SIGKILL)
        killed.wait(30)
    with Scratch(f"{PREFIX}one", tmp_path) as again:
        assert (again.path / "ca.key").read_text() == "secret"


def test_a_folder_without_a_lock_is_removed_when_its_certificates_have_expired(tmp_path):
    for name, age_s in (("new", 0), ("old", 32 * 86_400)):
        folder = tmp_path / f"{PREFIX}{name}"
        folder.mkdir()
        (folder / "host.key").write_text("secret")
        os.utime(folder, (folder.stat().st_atime - age_s, folder.stat().st_mtime - age_s))
    (tmp_path / "other").mkdir()
    assert [path.name for path in remove_stale(tmp_path)] == [f"{PREFIX}old"]
    assert (tmp_path / "other").exists()


def test_a_folder_that_is_a_link_is_neither_used_nor_removed(tmp_path):
    (tmp_path / "target").mkdir()
    (tmp_path / f"{PREFIX}link").symlink_to(tmp_path / "target")
    assert remove_stale(tmp_path) == []
    with pytest.raises(WorldError, match="belongs to another user"):
        Scratch(f"{PREFIX}link", tmp_path)


def test_a_worker_keeps_its_keys_in_memory_and_leaves_nothing(tmp_path, monkeypatch):
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    files = {"ca.pem": os.urandom(8), "host.key": b"secret", "host.pem": b"x", "name.txt": b"ray-0123\n"}
    worker = RayWorker("tls/127.0.0.1:1", files, 1, "auto")
    found = sorted(memory_folder().glob(f"{PREFIX}0123-*"))
    assert [path.name for path in found[-1].iterdir() if path.name != ".lock"]
    assert not any(path.name == "host.key" for path in tmp_path.rglob("*")), "a key on the disk"
    worker.stop()
    assert not found[-1].exists()
    assert list(tmp_path.iterdir()) == []
