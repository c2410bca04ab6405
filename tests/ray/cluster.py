"""Starts a Ray cluster of two raylets on this machine, and kills processes and nodes during a run on it."""

from __future__ import annotations

import os
import signal
import subprocess
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from tests.builders.engine_runs import HURTS, archived, factory, outcomes, until


@contextmanager
def ray_cluster() -> Iterator[Any]:
    """Starts a head without CPUs and two nodes of one CPU each."""
    from ray import cluster_utils

    handler = signal.getsignal(signal.SIGTERM)  # the Ray head replaces this handler
    started = cluster_utils.Cluster(initialize_head=True, head_node_args={"num_cpus": 0, "include_dashboard": False})
    try:
        for _ in range(2):
            started.add_node(num_cpus=1)
        yield started
    finally:
        started.shutdown()
        signal.signal(signal.SIGTERM, handler)


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
    """Returns the parent of a process."""
    return int(Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[1])


def run_with_kills(cluster: Any, plan: tuple[str, ...], out: Path) -> None:
    """Runs a plan on a cluster, kills an actor, a worker and a node, and adds a node; no failure may be recorded."""
    one, other = sorted(cluster.worker_nodes, key=lambda node: node.node_id)
    command = factory("run", *plan, "--out", out, "--engine", "ray", "--address", cluster.address)
    with subprocess.Popen(command) as run:
        until(lambda: archived(out) >= 2 and bool(workers_of(one)) and bool(workers_of(other)), run)
        (first,) = workers_of(one)
        os.kill(parent_of(first), signal.SIGKILL)  # kills the actor: its worker ends, Ray restarts it
        until(lambda: workers_of(one) not in ([], [first]), run)
        (worker,) = workers_of(other)
        os.kill(worker, signal.SIGKILL)
        until(lambda: workers_of(other) not in ([], [worker]), run)
        cluster.remove_node(other, allow_graceful=False)
        added = cluster.add_node(num_cpus=1)
        until(lambda: bool(workers_of(added)), run)
        assert run.wait(3600) == 0
    assert not any(workers_of(node) for node in (one, other, added))
    assert HURTS.isdisjoint(outcomes(out)), outcomes(out)
