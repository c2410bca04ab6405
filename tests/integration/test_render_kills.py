"""`factory render` with noise and appearance, with kills of a worker and of the coordinator, and with two workers.

No episode is lost or rendered twice. The dataset digest equals the digest of a run with one worker and without kills.
"""

from __future__ import annotations

import os
import signal
import sqlite3
import time
from collections.abc import Callable
from contextlib import closing
from pathlib import Path

import pytest

from factory.dataset.reader import Dataset
from factory.verify.dataset import verify
from schemas.terms import Recording
from tests.acceptance.factory_cli import FactoryCli, Started
from tests.builders.process_state import children_of
from tests.builders.rigs import write_rig

pytestmark = pytest.mark.gl


def until(condition: Callable[[], object], process: Started) -> None:
    deadline = time.monotonic() + 300
    while not condition():
        assert process.poll() is None, process.communicate()
        assert time.monotonic() < deadline, "timed out waiting"
        time.sleep(0.02)


def query(out: Path, text: str) -> list[tuple[object, ...]]:
    try:
        with closing(sqlite3.connect(f"file:{out / 'ledger.db'}?mode=ro", uri=True)) as ledger:
            return ledger.execute(text).fetchall()
    except sqlite3.OperationalError:  # the ledger is not written yet
        return []


def is_worker(pid: int) -> bool:
    """Returns whether a child process of a command is a worker."""
    return b"worker" in Path(f"/proc/{pid}/cmdline").read_bytes().split(b"\0")


@pytest.mark.slow
def test_kills_of_a_worker_and_of_the_coordinator_do_not_change_a_rendered_dataset(
    factory: FactoryCli, recordings: dict[Recording, Path], tmp_path: Path
) -> None:
    states, out, rig = recordings[Recording.STATES], tmp_path / "frames", write_rig(tmp_path)
    render = ("render", states, "--rig", rig, "--appearance", "full", "-o")
    factory(*render, tmp_path / "undisturbed", "--workers", 1)
    undisturbed = Dataset(tmp_path / "undisturbed")
    killed = factory.start(*render, out, "--workers", 1)
    until(lambda: query(out, "select 1 from jobs where state = 'leased'"), killed)
    (worker,) = filter(is_worker, children_of(killed.pid))
    os.kill(worker, signal.SIGKILL)
    until(lambda: list((out / "episodes").glob("*.zip")), killed)
    killed.kill()
    killed.wait(60)
    (first, *_) = sorted((out / "episodes").glob("*.zip"))
    written = first.stat().st_mtime_ns
    factory(*render, out, "--workers", 2)
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
