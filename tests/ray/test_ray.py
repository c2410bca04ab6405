"""`factory run --engine ray` on two real raylets of one machine, with killed actors, workers and a killed node."""

from __future__ import annotations

import os
import signal
import sqlite3
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from schemas.dataset.meta import read_dataset_meta

cluster_utils = pytest.importorskip("ray.cluster_utils")

PLAN = ("demo", "--scene", "office", "--episodes", "28", "--record", "states", "--gate", "skip")
HURTS = {"crash", "hang", "invalid"}


@pytest.fixture
def cluster() -> Iterator[Any]:
    """A head without CPUs and two nodes of one CPU each."""
    handler = signal.getsignal(signal.SIGTERM)  # the head replaces it
    started = cluster_utils.Cluster(initialize_head=True, head_node_args={"num_cpus": 0, "include_dashboard": False})
    for _ in range(2):
        started.add_node(num_cpus=1)
    yield started
    started.shutdown()
    signal.signal(signal.SIGTERM, handler)


def factory(*words: object) -> list[str]:
    return [sys.executable, "-m", "factory", *map(str, words)]


def digest_of(root: Path) -> str:
    digest = read_dataset_meta(root).dataset_digest
    assert digest is not None
    return digest


def outcomes(root: Path) -> dict[str, int]:
    with sqlite3.connect(f"file:{root / 'ledger.db'}?mode=ro", uri=True) as ledger:
        return dict(ledger.execute("SELECT outcome, count(*) FROM attempts GROUP BY outcome").fetchall())


def archived(root: Path) -> int:
    try:
        return outcomes(root).get("success", 0)
    except sqlite3.OperationalError:
        return 0


def until(condition: Callable[[], bool], process: subprocess.Popen[bytes], within_s: float = 300.0) -> None:
    end = time.monotonic() + within_s
    while not condition():
        assert process.poll() is None, "the run ended early"
        assert time.monotonic() < end, "timed out waiting"
        time.sleep(0.2)


def workers_of(node: Any) -> list[int]:
    """Returns the worker processes of a node, found by the folder of their certificates."""
    found = []
    for path in Path("/proc").glob("[0-9]*/cmdline"):
        try:
            words = path.read_bytes().split(b"\0")
        except OSError:
            continue
        if b"worker" in words and any(f"minivla-ray-{node.node_id[:12]}".encode() in word for word in words):
            found.append(int(path.parent.name))
    return found


def parent_of(pid: int) -> int:
    return int(Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[1])


def test_killed_actors_workers_and_nodes_change_no_episode_and_are_not_counted_as_crashes(
    cluster: Any, tmp_path: Path
) -> None:
    one, other = sorted(cluster.worker_nodes, key=lambda node: node.node_id)
    out = tmp_path / "ray"
    command = factory("run", *PLAN, "--out", out, "--engine", "ray", "--address", cluster.address)
    with subprocess.Popen(command) as run:
        until(lambda: archived(out) >= 2 and bool(workers_of(one)) and bool(workers_of(other)), run)
        (first,) = workers_of(one)
        os.kill(parent_of(first), signal.SIGKILL)  # the actor; Ray starts it again, and its worker ends
        until(lambda: workers_of(one) not in ([], [first]), run)
        (worker,) = workers_of(other)
        os.kill(worker, signal.SIGKILL)
        until(lambda: workers_of(other) not in ([], [worker]), run)
        cluster.remove_node(other, allow_graceful=False)
        added = cluster.add_node(num_cpus=1)
        until(lambda: bool(workers_of(added)), run)
        assert run.wait(600) == 0
    assert not any(workers_of(node) for node in (one, other, added))
    found = outcomes(out)
    assert HURTS.isdisjoint(found), found
    local = tmp_path / "local"
    subprocess.run(factory("run", *PLAN, "--out", local, "--workers", "2"), check=True)
    assert digest_of(out) == digest_of(local)
