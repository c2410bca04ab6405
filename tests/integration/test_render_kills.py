"""`factory render` with noise and appearance after kill -9 of a worker and of the coordinator, and with two workers.

No episode is lost or rendered twice, and the digest is that of one worker without kills.
"""

from __future__ import annotations

import os
import signal
import sqlite3
import subprocess
import sys
import time
from collections.abc import Callable
from contextlib import closing
from pathlib import Path

import pytest

from factory.dataset.reader import Dataset
from factory.verify.dataset import verify
from schemas.terms import Recording
from tests.builders.rigs import write_rig

pytestmark = pytest.mark.gl


def until(condition: Callable[[], object], process: subprocess.Popen[str]) -> None:
    deadline = time.monotonic() + 300
    while not condition():
        assert process.poll() is None, process.communicate()[1]
        assert time.monotonic() < deadline, "waited too long"
        time.sleep(0.02)


def query(out: Path, text: str) -> list[tuple[object, ...]]:
    try:
        with closing(sqlite3.connect(f"file:{out / 'ledger.db'}?mode=ro", uri=True)) as ledger:
            return ledger.execute(text).fetchall()
    except sqlite3.OperationalError:  # not written yet
        return []


def children_of(process: subprocess.Popen[str]) -> list[int]:
    tasks = Path(f"/proc/{process.pid}/task").glob("*/children")
    return [int(child) for task in tasks for child in task.read_text().split()]


def is_worker(pid: int) -> bool:
    return b"worker" in Path(f"/proc/{pid}/cmdline").read_bytes().split(b"\0")


def render(states: Path, rig: Path, out: Path, workers: int) -> subprocess.Popen[str]:
    words = ("render", states, "--rig", rig, "--appearance", "full", "-o", out, "--workers", workers)
    command = [sys.executable, "-m", "factory", *map(str, words)]
    return subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)


def test_kills_of_a_worker_and_of_the_coordinator_change_nothing(
    recordings: dict[Recording, Path], tmp_path: Path
) -> None:
    states, out, rig = recordings[Recording.STATES], tmp_path / "frames", write_rig(tmp_path)
    with render(states, rig, tmp_path / "undisturbed", 1) as process:
        _, err = process.communicate()
    assert process.returncode == 0, err
    undisturbed = Dataset(tmp_path / "undisturbed")
    with render(states, rig, out, 1) as killed:
        until(lambda: query(out, "select 1 from jobs where state = 'leased'"), killed)
        (worker,) = filter(is_worker, children_of(killed))
        os.kill(worker, signal.SIGKILL)
        until(lambda: list((out / "episodes").glob("*.zip")), killed)
        killed.kill()
    (first, *_) = sorted((out / "episodes").glob("*.zip"))
    written = first.stat().st_mtime_ns
    with render(states, rig, out, 2) as again:
        _, err = again.communicate()
    assert again.returncode == 0, err
    assert first.stat().st_mtime_ns == written
    report = verify(out, deep=True)
    assert (report.ok, report.complete) == (True, True)
    assert report.digest == undisturbed.digest
    for episode in undisturbed:
        drawn = episode.appearance
        assert drawn is not None
        assert all((drawn.light, drawn.materials, drawn.camera, drawn.clutter))
    counts = query(out, "select count(*) from events where event in ('archived', 'adopted') group by job_id")
    assert counts == [(1,)] * len(Dataset(states))
    assert list((out / ".staging").iterdir()) == []
