"""Tests `factory run --engine ray` on two real raylets of one machine; an actor, a worker and a node are killed."""

from __future__ import annotations

import subprocess
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from tests.builders.engine_runs import digest_of, factory
from tests.ray.cluster import ray_cluster, run_with_kills

pytest.importorskip("ray")

PLAN = ("demo", "--scene", "office", "--episodes", "28", "--record", "states", "--gate", "skip")


@pytest.fixture
def cluster() -> Iterator[Any]:
    with ray_cluster() as started:
        yield started


def test_killed_actors_workers_and_nodes_change_no_episode_and_are_not_counted_as_crashes(
    cluster: Any, tmp_path: Path
) -> None:
    out, local = tmp_path / "ray", tmp_path / "local"
    run_with_kills(cluster, PLAN, out)
    subprocess.run(factory("run", *PLAN, "--out", local, "--workers", "2"), check=True)
    assert digest_of(out) == digest_of(local)
