"""A run submitted by `factory submit slurm`, and functions that stop its tasks in each way that Slurm can."""

from __future__ import annotations

import json
import re
import subprocess
import time
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

from coordinator.ledger.states import Event
from tests.builders.engine_runs import archived, factory
from tests.slurm.cluster import SlurmCluster
from tests.slurm.leases import FALSE_ENDS, ends, held, waiting

_LIMIT = "01:00:00"
"""Time limit of the tasks; long enough that no task reaches it."""
_SHORT_LIMIT = "00:02:00"
"""Time limit so short that Slurm sends the warning signal at its next check of the limits, within half a minute."""
_REQUEUED = "stopped before the run was finished: requeueing"
"""Line in the log of a task that has queued itself again before its time limit."""
_PREEMPTED = "DUE TO PREEMPTION"
_SESSION = re.compile(r"worker_started.* sid=(\S+)")
"""Line in the log of a worker with its session ID, by which the ledger refers to the worker."""


class Task(NamedTuple):
    """Running task of an array."""

    number: int
    node: str
    restarts: int
    """Number of times that the task was requeued."""


class SubmittedRun:
    """Slurm jobs of a run in `folder`: 7 shards, or 5 workers and a coordinator, depending on `mode`."""

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
        """Returns the dataset directory to which a task adds episodes."""
        return self.folder / "shards" / str(task) if self._mode == "shards" else self.folder / "dataset"

    def ledgers(self) -> list[Path]:
        """Returns the directories of all datasets that can have a ledger."""
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
                found.append(Task(int(number), node, self.restarts(f"{self.array}_{number}")))
        return found

    def restarts(self, job: str) -> int:
        """Returns the number of times that a job was requeued."""
        text = self._cluster.call("scontrol", "show", "job", job)
        found = re.search(r"Restarts=(\d+)", text)
        assert found is not None, text
        return int(found[1])

    def at_work(self, is_suitable: Callable[[Task], bool] = lambda _task: True) -> Task:
        """Waits for a running task that simulates a job and whose dataset has an episode; returns it."""
        found: list[Task] = []

        def has_one() -> bool:
            found[:] = [each for each in self.running() if is_suitable(each) and self._works(each)]
            return bool(found)

        self._cluster.wait(has_one, "a task with an episode and a job")
        return found[0]

    def cancel_one(self) -> str:
        """Cancels tasks until one has lost a job; returns the comma-separated numbers of all cancelled tasks."""
        cancelled: list[int] = []

        def cancel(task: Task) -> None:
            cancelled.append(task.number)
            self._cluster.call("scancel", f"{self.array}_{task.number}")

        self._strike(cancel, lambda task: self._state_of(task.number) == "CANCELLED")
        return ",".join(map(str, cancelled))

    def requeue_one(self) -> None:
        """Requeues a running task."""
        self._strike(lambda task: self._requeue(f"{self.array}_{task.number}"), self._has_restarted)

    def requeue_coordinator(self) -> None:
        """Requeues the coordinator while workers have jobs; it then starts with another port and a new certificate."""
        dataset, job = self.folder / "dataset", str(self.jobs["coordinator"])
        self._resume()
        self.at_work()
        since, restarts = time.time(), self.restarts(job)
        self._requeue(job)
        self._cluster.wait(lambda: self.restarts(job) > restarts and not self.node_of("coordinator"), "the requeue")
        done = archived(dataset)
        assert waiting(dataset), "no job is left for the restarted coordinator"
        self._cluster.wait(lambda: archived(dataset) > done, "an episode after the restart")
        assert FALSE_ENDS.isdisjoint(ends(dataset, since))

    def preempt_one(self, excluded: str) -> None:
        """Submits an urgent job that needs the whole node of a task, so Slurm preempts the task."""
        script = self.folder / "urgent.sh"
        script.write_text("#!/bin/bash\nsleep 2\n")
        urgent: list[int] = []

        def preempt(task: Task) -> None:
            options = ("--partition=high", f"--nodelist={task.node}", "--exclusive")
            log = f"--output={self.folder}/urgent.log"
            urgent.append(int(self._cluster.call("sbatch", "--parsable", *options, log, script)))

        def is_over(task: Task) -> bool:
            return self._has_restarted(task) and self._cluster.state_of(urgent[-1]) == "COMPLETED"

        self._strike(preempt, is_over, is_suitable=lambda each: each.node != excluded)
        assert self._logged(_PREEMPTED)

    def drain_node(self, excluded: str) -> None:
        """Drains the node of a task, as for maintenance, moves its tasks to other nodes, and resumes the node."""

        def drain(task: Task) -> None:
            self._cluster.call("scontrol", "update", f"nodename={task.node}", "state=drain", "reason=test")
            for each in self.running():
                if each.node == task.node:
                    self._requeue(f"{self.array}_{each.number}")

        def is_empty(task: Task) -> bool:
            return self._has_restarted(task) and all(each.node != task.node for each in self.running())

        def resume(task: Task) -> None:
            self._cluster.call("scontrol", "update", f"nodename={task.node}", "state=resume")

        self._strike(drain, is_empty, resume, is_suitable=lambda each: each.node != excluded)

    def fail_node(self, excluded: str) -> None:
        """Kills the node of a task with all its processes, and starts it again later.

        The processes cannot return their jobs, so the leases expire.
        """

        self._strike(
            lambda task: self._cluster.kill_node(task.node),
            self._has_restarted,
            lambda task: self._cluster.start_node(task.node),
            is_suitable=lambda each: each.node != excluded,
            end=Event.EXPIRED,
        )

    def reach_time_limit(self) -> None:
        """Shortens the time limit of a running task, so the task requeues itself shortly before the limit.

        The simulation process of the task is stopped until then. Otherwise, a shard on a fast machine could end before
        Slurm checks the time limits again.
        """

        def shorten(task: Task) -> None:
            name = f"{self.array}_{task.number}"
            with self._cluster.frozen(name, task.node):
                self._limit(name, _SHORT_LIMIT)
                self._cluster.wait(lambda: not self._runs(task.number), "the signal before the time limit")

        def lengthen(task: Task) -> None:
            self._limit(f"{self.array}_{task.number}", _LIMIT)

        self._strike(shorten, self._has_restarted, lengthen)
        assert self._logged(_REQUEUED)

    def wait_for_end(self, job: str) -> str:
        """Waits until all tasks of a job have ended; returns their states."""
        ended = {"COMPLETED", "CANCELLED", "FAILED", "TIMEOUT", "NODE_FAIL"}
        self._cluster.wait(
            lambda: set(self._cluster.state_of(self.jobs[job]).split()) <= ended, f"the end of job {job}", 7200
        )
        return self._cluster.state_of(self.jobs[job])

    def resubmit(self, job: str, *options: str) -> None:
        """Submits the script of a job of the run again."""
        script = self.folder / "slurm" / f"{job}.sh"
        self.jobs[job] = int(self._cluster.call("sbatch", "--parsable", *options, script))

    def node_of(self, job: str) -> str:
        """Returns the node on which a job runs; empty if it does not run."""
        return self._cluster.call("squeue", "--noheader", f"--jobs={self.jobs[job]}", "--states=RUNNING", "--format=%N")

    def _strike(
        self,
        event: Callable[[Task], None],
        is_over: Callable[[Task], bool],
        recover: Callable[[Task], None] = lambda _task: None,
        *,
        is_suitable: Callable[[Task], bool] = lambda _task: True,
        end: Event = Event.RELEASED,
    ) -> None:
        """Stops a task that has a job; repeats this with other tasks until a stopped task has lost a job.

        The run is paused while Slurm reacts and until a suitable task runs. Otherwise, a fast machine could finish all
        jobs before the next event.

        Args:
            event: function that stops the task.
            is_over: returns whether Slurm has reacted.
            recover: undoes the effect of the event on the task or its node.
            is_suitable: returns whether `event` may stop this task.
            end: ledger event that must record the loss of the job.
        """
        while True:
            # the run is still paused, because Slurm starts a requeued task only after some minutes
            self._cluster.wait(lambda: any(map(is_suitable, self.running())), "a running task")
            self._resume()
            task = self.at_work(is_suitable)
            session, since = self._session(task), time.time()
            event(task)
            self._pause()
            self._wait_for(task, is_over)
            found = self._ends(task, session, since)
            recover(task)
            assert FALSE_ENDS.isdisjoint(found), found
            if found[end]:
                return

    def _wait_for(self, task: Task, is_over: Callable[[Task], bool]) -> None:
        """Waits until Slurm has reacted to an event or, because a shard may finish first, the task is complete."""
        self._cluster.wait(
            lambda: is_over(task) or self._state_of(task.number) == "COMPLETED", f"the reaction to an event of {task}"
        )

    def _ends(self, task: Task, session: str | None, since: float) -> Counter[str]:
        """Waits until a stopped task has lost its jobs; returns the number of its job events by kind since a time."""
        dataset = self.dataset_of(task.number)
        left = held(dataset, session)
        self._cluster.wait(lambda: left.isdisjoint(held(dataset, session)), f"the end of the jobs of {task}")
        return ends(dataset, since, session)

    def _works(self, task: Task) -> bool:
        """Returns whether a task has a job and its dataset contains an episode."""
        dataset = self.dataset_of(task.number)
        return archived(dataset) > 0 and bool(held(dataset, self._session(task)))

    def _session(self, task: Task) -> str | None:
        """Returns the session ID of a worker in the ledger; `None` for a shard, which has a separate ledger."""
        if self._mode == "shards":
            return None
        found = _SESSION.findall((self.folder / "slurm" / f"workers-{task.number}.log").read_text())
        return found[-1] if found else "none yet"

    def _pause(self) -> None:
        """Pauses the run as an operator does; does nothing for shards, which have no common coordinator."""
        self._switch("pause")

    def _resume(self) -> None:
        self._switch("resume")

    def _switch(self, action: str) -> None:
        if self._mode == "shards":
            return
        keys = self.folder / "pki" / "operator"
        if not keys.exists():
            self._cluster.wait(lambda: bool(archived(self.folder / "dataset")), "an episode")
            self._factory("keys", "host", keys.parent, keys.name, "--role", "operator")
        self._factory("jobs", action, self.folder / "dataset", "--tls", keys)

    def _factory(self, *words: object) -> None:
        done = subprocess.run(factory(*words), capture_output=True, text=True, check=False)
        assert done.returncode == 0, done.stderr

    def _has_restarted(self, task: Task) -> bool:
        return self.restarts(f"{self.array}_{task.number}") > task.restarts

    def _requeue(self, job: str) -> None:
        """Requeues a job; does nothing if the job has just requeued itself at its time limit."""
        self._cluster.call("scontrol", "requeue", job, accepted=("Job is pending execution",))

    def _limit(self, job: str, limit: str) -> None:
        """Sets the time limit of a job; does nothing if the job has ended."""
        accepted = ("Job/step already completing or completed", "Job has already finished")
        self._cluster.call("scontrol", "update", f"jobid={job}", f"timelimit={limit}", accepted=accepted)

    def _runs(self, number: int) -> bool:
        return any(task.number == number for task in self.running())

    def _logged(self, text: str) -> bool:
        """Returns whether the log of any task contains a text."""
        return any(text in log.read_text() for log in (self.folder / "slurm").glob(f"{self._mode}-*.log"))

    def _state_of(self, task: int) -> str:
        return self._cluster.state_of(f"{self.array}_{task}")
