"""Runs 240 episodes as one run, as 7 shards, on Slurm and on Ray, with kills; all datasets have the same digest.

`make test-engines` runs these tests; they take half an hour on two cores.
"""

from __future__ import annotations

import os
import signal
import subprocess
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.builders.engine_runs import HURTS, archived, digest_of, factory, outcomes, until
from tests.ray.cluster import ray_cluster, run_with_kills
from tests.slurm.cluster import SlurmCluster, running_cluster
from tests.slurm.submitted import SubmittedRun

pytestmark = pytest.mark.timeout(10_000)

EPISODES, SHARDS = 240, 7
PLAN = ("demo", "--scene", "office", "--episodes", str(EPISODES), "--record", "states")
UNGATED = (*PLAN, "--gate", "skip")


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The dataset of one run on this machine."""
    root = tmp_path_factory.mktemp("whole") / "dataset"
    subprocess.run(factory("run", *UNGATED, "--out", root, "--workers", 2), check=True)
    return root


@pytest.fixture(scope="module")
def digest(whole: Path) -> str:
    return digest_of(whole)


@pytest.fixture(scope="module")
def slurm() -> Iterator[SlurmCluster]:
    with running_cluster() as started:
        yield started


def test_seven_shards_of_which_three_are_killed_and_resumed_give_the_digest_of_one_run(
    whole: Path, digest: str, tmp_path: Path
) -> None:
    shards = tmp_path / "shards"
    for number in range(1, SHARDS + 1):
        out = shards / str(number)
        command = factory("run", *UNGATED, "--shard", f"{number}/{SHARDS}", "--out", out, "--workers", 2)
        command += ["--scenes", str(whole / "scenes")]
        if number in {2, 4, 6}:
            with subprocess.Popen(command, start_new_session=True) as killed:
                until(lambda out=out, number=number: archived(out) >= 2 * number, killed)  # type: ignore[misc]
                os.killpg(killed.pid, signal.SIGKILL)
        subprocess.run(command, check=True)
        require_no_false_failure(out)
    joined = tmp_path / "joined"
    subprocess.run(factory("gather", *PLAN, shards, "--out", joined), check=True)
    assert digest_of(joined) == digest
    assert archived(joined) == EPISODES


def test_shards_on_slurm_that_are_stopped_in_every_way_give_the_digest_of_one_run(
    slurm: SlurmCluster, digest: str, tmp_path: Path
) -> None:
    with slurm.without("n2", "n3"):  # runs two shards at a time, so some remain after half a minute
        run = SubmittedRun(slurm, tmp_path / "run", "shards", PLAN)
        run.reach_time_limit()
    cancelled = run.cancel_one()
    run.requeue_one()
    run.preempt_one("")
    run.drain_node("")
    run.fail_node("")
    assert run.wait_for_end("shards") == "CANCELLED COMPLETED"
    assert run.wait_for_end("gather") == "FAILED"  # the cancelled shard is not finished
    run.resubmit("shards", f"--array={cancelled}")
    run.resubmit("gather", f"--dependency=afterok:{run.jobs['shards']}")
    assert run.wait_for_end("gather") == "COMPLETED"
    assert digest_of(tmp_path / "run" / "dataset") == digest
    require_no_false_failure(*run.ledgers())


def test_workers_on_slurm_that_are_stopped_in_every_way_give_the_digest_of_one_run(
    slurm: SlurmCluster, digest: str, tmp_path: Path
) -> None:
    with slurm.without("n2", "n3"):  # one worker only: jobs remain after half a minute
        run = SubmittedRun(slurm, tmp_path / "run", "workers", PLAN)
        run.reach_time_limit()
    run.cancel_one()
    run.requeue_one()
    run.preempt_one(run.node_of("coordinator"))
    run.drain_node(run.node_of("coordinator"))
    run.fail_node(run.node_of("coordinator"))
    run.requeue_coordinator()
    assert run.wait_for_end("coordinator") == "COMPLETED"
    assert run.wait_for_end("workers") == "CANCELLED COMPLETED"
    assert digest_of(tmp_path / "run" / "dataset") == digest
    require_no_false_failure(*run.ledgers())


def test_a_run_on_ray_with_kills_gives_the_digest_of_one_run(digest: str, tmp_path: Path) -> None:
    with ray_cluster() as cluster:
        run_with_kills(cluster, UNGATED, tmp_path / "ray")
    assert digest_of(tmp_path / "ray") == digest


def require_no_false_failure(*roots: Path) -> None:
    """Checks that no kill of these tests was recorded as a failure of a host or a job."""
    for root in roots:
        found = outcomes(root)
        assert HURTS.isdisjoint(found), (root, found)
