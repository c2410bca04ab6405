"""Tests the scripts of `factory submit slurm` on a real Slurm: arrays, dependencies, and all ways to stop a task.

Most tests replace `factory` by a short shell program that also drains when it is stopped. The last test generates a
dataset with `factory`.
"""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from factory.submit.slurm import SlurmJob, write_scripts
from schemas.dataset.meta import read_dataset_meta
from tests.slurm.cluster import SlurmCluster, running_cluster

pytestmark = pytest.mark.timeout(4_000)

_STUB = """#!/bin/bash
# drains on SIGTERM; runs until the file `finish` exists
log={folder}/told-${{SLURM_ARRAY_TASK_ID:-0}}
echo "$1" >> "$log"
[ "$1" = gather ] && exit 0
trap 'sleep 0.5; echo drained >> "$log"; exit 130' TERM
while [ ! -e {folder}/finish ]; do sleep 0.1; done
"""


@pytest.fixture(scope="module")
def cluster() -> Iterator[SlurmCluster]:
    with running_cluster() as started:
        yield started


class StubRun:
    """A run whose tasks are the shell program; `told` returns the words that a task has written."""

    def __init__(self, cluster: SlurmCluster, folder: Path, tasks: int = 1, time: str = "10") -> None:
        self._cluster, self.folder = cluster, folder
        (folder / "slurm").mkdir()
        stub = folder / "stub"
        stub.write_text(_STUB.format(folder=folder))
        stub.chmod(0o755)
        job = SlurmJob(folder, tasks, 1, time, setup=(f"export TMPDIR={folder}",), factory=(str(stub),))
        self.scripts = write_scripts(job, "shards")
        self.job = int(cluster.call("sbatch", "--parsable", self.scripts[0]))

    def started(self, task: int = 1) -> None:
        self._cluster.wait(lambda: "run" in self.told(task), f"start of task {task}")

    def told(self, task: int = 1) -> list[str]:
        path = self.folder / f"told-{task}"
        return path.read_text().split() if path.exists() else []

    def is_queued_again(self) -> bool:
        text = self._cluster.call("scontrol", "show", "job", f"{self.job}_1")
        return "JobState=PENDING" in text and "Restarts=1" in text

    def cancel(self) -> None:
        self._cluster.call("scancel", self.job)


@pytest.fixture
def run(cluster: SlurmCluster, tmp_path: Path) -> Iterator[StubRun]:
    made = StubRun(cluster, tmp_path)
    made.started()
    yield made
    made.cancel()


def test_a_cancelled_task_drains_and_is_not_queued_again(cluster, run):
    run.cancel()
    cluster.wait(lambda: cluster.state_of(run.job) == "CANCELLED", "the end")
    cluster.wait(lambda: run.told() == ["run", "drained"], "the drain")
    assert not run.is_queued_again()


def test_a_requeued_task_drains_and_is_queued_again(cluster, run):
    cluster.call("scontrol", "requeue", f"{run.job}_1")
    cluster.wait(run.is_queued_again, "the requeue")
    assert run.told() == ["run", "drained"]


def test_a_task_drains_and_queues_itself_again_before_its_time_limit(cluster, tmp_path):
    run = StubRun(cluster, tmp_path, time="2")
    cluster.wait(run.is_queued_again, "the requeue")
    assert run.told() == ["run", "drained"]
    run.cancel()


def test_a_preempted_task_drains_and_is_queued_again(cluster, run, tmp_path):
    urgent = tmp_path / "urgent.sh"
    urgent.write_text("#!/bin/bash\nsleep 1\n")
    options = ("--partition=high", "--nodes=3", "--exclusive", f"--output={tmp_path}/urgent.log")
    other = int(cluster.call("sbatch", "--parsable", *options, urgent))
    cluster.wait(run.is_queued_again, "the requeue")
    assert run.told() == ["run", "drained"]
    cluster.wait(lambda: cluster.state_of(other) == "COMPLETED", "the urgent job")


def test_the_shards_are_gathered_after_the_last_task_of_the_array(cluster, tmp_path):
    run = StubRun(cluster, tmp_path, tasks=3)
    gather = int(cluster.call("sbatch", "--parsable", f"--dependency=afterany:{run.job}", run.scripts[1]))
    for task in (1, 2, 3):
        run.started(task)
    assert cluster.state_of(gather) == "PENDING"
    (tmp_path / "finish").touch()
    cluster.wait(lambda: cluster.state_of(gather) == "COMPLETED", "the gather job")
    assert run.told(0) == ["gather"]


@pytest.mark.parametrize("mode", ["shards", "workers"])
def test_a_submitted_run_has_the_digest_of_a_run_on_one_machine(cluster, tmp_path, mode):
    plan = ("demo", "--scene", "office", "--episodes", 2, "--record", "states")
    submitted = json.loads(
        _factory(
            cluster,
            "submit",
            "slurm",
            *plan,
            "--out",
            tmp_path / "run",
            "--tasks",
            2,
            "--cpus",
            1,
            "--mode",
            mode,
            "--json",
        )
    )
    last = submitted["jobs"]["gather" if mode == "shards" else "coordinator"]
    _factory(cluster, "run", *plan, "--out", tmp_path / "whole", "--workers", 1)
    cluster.wait(lambda: cluster.state_of(last) == "COMPLETED", "the dataset", 3600.0)
    digest = read_dataset_meta(tmp_path / "run" / "dataset").dataset_digest
    assert digest is not None
    assert digest == read_dataset_meta(tmp_path / "whole").dataset_digest


def test_a_task_of_a_failed_node_is_queued_again(cluster, run):
    node = next(
        word.partition("=")[2]
        for word in cluster.call("scontrol", "show", "job", f"{run.job}_1").split()
        if word.startswith("NodeList=")
    )
    cluster.kill_node(node)
    cluster.wait(run.is_queued_again, "the requeue")


def _factory(cluster: SlurmCluster, *words: object) -> str:
    done = subprocess.run(
        [sys.executable, "-P", "-m", "factory", *map(str, words)],
        env=cluster.environment,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    return done.stdout
