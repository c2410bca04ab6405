"""A run that `factory submit slurm` has submitted, and the events of Slurm that can stop its tasks."""

from __future__ import annotations

import json
import re
import subprocess
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

from tests.builders.engine_runs import archived, factory
from tests.slurm.cluster import SlurmCluster

_LIMIT = "00:04:00"
"""Time limit of a task. Slurm sends the signal two to three minutes before its end."""
_SHORT_LIMIT = "00:02:00"
"""Time limit with which Slurm sends the signal at its next check."""
_REQUEUED = "stopped before the run was finished: requeueing"
"""Line in the log of a task that has queued itself again before its time limit."""
_PREEMPTED = "DUE TO PREEMPTION"


class Task(NamedTuple):
    """Running task of an array."""

    number: int
    node: str
    restarts: int
    """Number of times that the task was queued again."""


class SubmittedRun:
    """Jobs of a run with 7 shards, or with 5 workers and a coordinator, in the folder `folder`."""

    def __init__(self, cluster: SlurmCluster, folder: Path, mode: str, plan: tuple[str, ...]) -> None:
        self._cluster, self._mode, self.folder = cluster, mode, folder
        tasks = ("--tasks", 7 if mode == "shards" else 5, "--cpus", 1, "--time", _LIMIT)
        scratch = folder.parent / "scratch"
        scratch.mkdir(exist_ok=True)
        done = subprocess.run(
            factory("submit", "slurm", *plan, "--out", folder, "--mode", mode, "--json", *tasks),
            env={**cluster.environment, "TMPDIR": str(scratch)},
            capture_output=True,
            text=True,
            check=False,
        )
        assert done.returncode == 0, done.stderr
        self.jobs: dict[str, int] = json.loads(done.stdout)["jobs"]
        self.array = self.jobs[mode]

    def dataset_of(self, task: int) -> Path:
        """Returns the dataset to which a task adds episodes."""
        return self.folder / "shards" / str(task) if self._mode == "shards" else self.folder / "dataset"

    def ledgers(self) -> list[Path]:
        """Returns the datasets with a ledger."""
        return [*self.folder.glob("shards/*"), self.folder / "dataset"]

    def running(self) -> list[Task]:
        """Returns the running tasks of the array."""
        shown = self._cluster.call(
            "squeue", "--noheader", f"--jobs={self.array}", "--states=RUNNING", "--format=%K %N"
        ).splitlines()
        found = []
        for line in shown:
            number, node = line.split()
            if number.isdigit():
                found.append(Task(int(number), node, self.restarts(int(number))))
        return found

    def restarts(self, task: int) -> int:
        """Returns the number of times that a task was queued again."""
        text = self._cluster.call("scontrol", "show", "job", f"{self.array}_{task}")
        found = re.search(r"Restarts=(\d+)", text)
        assert found is not None, text
        return int(found[1])

    def productive(self, is_suitable: Callable[[Task], bool] = lambda _task: True) -> Task:
        """Waits for a running task whose dataset has an episode, and returns it."""
        found: list[Task] = []

        def has_one() -> bool:
            found[:] = [each for each in self.running() if is_suitable(each) and archived(self.dataset_of(each.number))]
            return bool(found)

        self._cluster.wait(has_one, "a task with an episode")
        return found[0]

    def cancel_one(self) -> int:
        """Cancels a task; returns its number."""
        task = self.productive().number
        self._cluster.call("scancel", f"{self.array}_{task}")
        self._cluster.wait(lambda: self._state_of(task) == "CANCELLED", "the end of the cancelled task")
        return task

    def requeue_one(self) -> None:
        """Queues a running task again."""
        task = self.productive()
        self._requeue(f"{self.array}_{task.number}")
        self._wait_for_restart(task)

    def requeue_coordinator(self) -> None:
        """Queues the coordinator again, which then gets another port and a new certificate."""
        self._cluster.wait(lambda: bool(self.node_of("coordinator")), "the coordinator")
        self._requeue(str(self.jobs["coordinator"]))

    def preempt_one(self, excluded: str) -> None:
        """Submits urgent jobs that take the whole node of a task, until one has preempted a task."""
        script = self.folder / "urgent.sh"
        script.write_text("#!/bin/bash\nsleep 2\n")
        while not self._logged(_PREEMPTED):
            task = self.productive(lambda each: each.node != excluded)
            options = (
                "--partition=high",
                f"--nodelist={task.node}",
                "--exclusive",
                f"--output={self.folder}/urgent.log",
            )
            urgent = int(self._cluster.call("sbatch", "--parsable", *options, script))
            self._wait_for_restart(task)
            self._cluster.wait(lambda urgent=urgent: self._cluster.state_of(urgent) == "COMPLETED", "the urgent job")

    def drain_node(self, excluded: str) -> None:
        """Drains the node of a task, as for maintenance: its tasks move to other nodes; then resumes the node."""
        task = self.productive(lambda each: each.node != excluded)
        self._cluster.call("scontrol", "update", f"nodename={task.node}", "state=drain", "reason=test")
        for each in self.running():
            if each.node == task.node:
                self._requeue(f"{self.array}_{each.number}")
        self._wait_for_restart(task)
        self._cluster.wait(lambda: all(each.node != task.node for each in self.running()), "an empty node")
        self._cluster.call("scontrol", "update", f"nodename={task.node}", "state=resume")

    def fail_node(self, excluded: str) -> None:
        """Kills the node of a task with all its processes, and starts it again later."""
        task = self.productive(lambda each: each.node != excluded)
        self._cluster.kill_node(task.node)
        self._wait_for_restart(task)
        self._cluster.start_node(task.node)

    def reach_time_limit(self) -> None:
        """Shortens the time limit of running tasks until one has queued itself again before its end.

        A fast machine finishes its tasks before their usual limit. The next run of the task has that limit again.
        """
        while not self._logged(_REQUEUED):
            task = self.productive()
            name = f"{self.array}_{task.number}"
            self._limit(name, _SHORT_LIMIT)
            self._cluster.wait(
                lambda task=task: self.restarts(task.number) > task.restarts or not self._runs(task.number),  # type: ignore[misc]
                f"the time limit or the end of task {task.number}",
            )
            self._limit(name, _LIMIT)

    def wait_for_end(self, job: str) -> str:
        """Waits until all tasks of a job have ended; returns their states."""
        ended = {"COMPLETED", "CANCELLED", "FAILED", "TIMEOUT", "NODE_FAIL"}
        self._cluster.wait(
            lambda: set(self._cluster.state_of(self.jobs[job]).split()) <= ended, f"the end of job {job}", 7200
        )
        return self._cluster.state_of(self.jobs[job])

    def resubmit(self, job: str, *options: str) -> None:
        """Submits a script of the run again."""
        script = self.folder / "slurm" / f"{job}.sh"
        self.jobs[job] = int(self._cluster.call("sbatch", "--parsable", *options, script))

    def node_of(self, job: str) -> str:
        """Returns the node on which a job runs; empty if it does not run."""
        return self._cluster.call("squeue", "--noheader", f"--jobs={self.jobs[job]}", "--states=RUNNING", "--format=%N")

    def _requeue(self, job: str) -> None:
        """Queues a job again; one that has just queued itself again at its time limit stays as it is."""
        self._cluster.call("scontrol", "requeue", job, accepted="Job is pending execution")

    def _limit(self, job: str, limit: str) -> None:
        """Sets the time limit of a job; one that has ended keeps its limit."""
        accepted = "Job/step already completing or completed"
        self._cluster.call("scontrol", "update", f"jobid={job}", f"timelimit={limit}", accepted=accepted)

    def _runs(self, number: int) -> bool:
        return any(task.number == number for task in self.running())

    def _logged(self, text: str) -> bool:
        """Returns whether the log of a task has a text."""
        return any(text in log.read_text() for log in (self.folder / "slurm").glob(f"{self._mode}-*.log"))

    def _state_of(self, task: int) -> str:
        return self._cluster.state_of(f"{self.array}_{task}")

    def _wait_for_restart(self, task: Task) -> None:
        self._cluster.wait(lambda: self.restarts(task.number) > task.restarts, f"the restart of task {task.number}")
