"""Slurm on loopback with three simulated nodes: Debian's munged, slurmctld and slurmd with a private configuration.

Needs root, because slurmd must start tasks as other users. Changes no file of the system.
"""

from __future__ import annotations

import contextlib
import os
import re
import secrets
import shutil
import signal
import socket
import subprocess
import tempfile
import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from types import TracebackType
from typing import Self

import pytest

from tests.builders.ports import free_endpoint

PROGRAMS = ("munged", "slurmctld", "slurmd", "sbatch", "scontrol", "scancel", "squeue")
NODES, CORES = 3, 2
_SYSTEM = "/usr/local/sbin:/usr/sbin:/sbin:/usr/local/bin:/usr/bin:/bin"
_CONFIGURATION = """
ClusterName=test
SlurmctldHost={host}(127.0.0.1)
SlurmctldPort={ports[0]}
SlurmUser=root
AuthType=auth/munge
AuthInfo=socket={folder}/munge/socket
CryptoType=crypto/munge
StateSaveLocation={folder}/state
SlurmctldPidFile={folder}/slurmctld.pid
SlurmdPidFile={folder}/slurmd-%n.pid
SlurmdSpoolDir={folder}/spool-%n
ProctrackType=proctrack/linuxproc
TaskPlugin=task/none
MpiDefault=none
SwitchType=switch/none
ReturnToService=2
SlurmdParameters=config_overrides
SelectType=select/cons_tres
SelectTypeParameters=CR_Core
SchedulerParameters=batch_sched_delay=0,sched_interval=1
KillWait=10
MinJobAge=600
PreemptType=preempt/partition_prio
PreemptMode=REQUEUE
NodeName=n1 NodeHostname={host} NodeAddr=127.0.0.1 Port={ports[1]} CPUs={cores} RealMemory=16000
NodeName=n2 NodeHostname={host} NodeAddr=127.0.0.1 Port={ports[2]} CPUs={cores} RealMemory=16000
NodeName=n3 NodeHostname={host} NodeAddr=127.0.0.1 Port={ports[3]} CPUs={cores} RealMemory=16000
PartitionName=low Nodes=ALL Default=YES MaxTime=INFINITE PriorityTier=1 State=UP
PartitionName=high Nodes=ALL MaxTime=INFINITE PriorityTier=10 PreemptMode=OFF State=UP
"""


def why_no_slurm() -> str:
    """Returns why no cluster can be started here; empty if one can."""
    missing = [name for name in PROGRAMS if shutil.which(name, path=_SYSTEM) is None]
    if missing:
        return f"{', '.join(missing)} is not installed; on Debian: apt-get install slurm-wlm munge"
    return "" if os.geteuid() == 0 else "slurmd needs root, e.g. in a container"


@contextmanager
def running_cluster() -> Iterator[SlurmCluster]:
    """Yields a cluster in a temporary folder; fails the test if none can be started here."""
    reason = why_no_slurm()
    if reason:
        pytest.fail(reason)
    with tempfile.TemporaryDirectory(prefix="slurm-") as folder, SlurmCluster(Path(folder)) as started:
        yield started


class SlurmCluster:
    """A running cluster. Context manager; Slurm commands with the variables of `environment` use this cluster."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._processes: dict[str, subprocess.Popen[bytes]] = {}
        self.environment = {**os.environ, "SLURM_CONF": str(folder / "slurm.conf"), "PATH": _SYSTEM}

    def __enter__(self) -> Self:
        try:
            self._start_all()
        except BaseException:
            self._end()
            raise
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._end()

    def call(self, *words: object, accepted: tuple[str, ...] = ()) -> str:
        """Runs a Slurm command and returns its output; ignores errors whose text contains one of `accepted`."""
        done = subprocess.run(
            [*map(str, words)], env=self.environment, capture_output=True, text=True, check=False, timeout=60
        )
        assert done.returncode == 0 or any(text in done.stderr for text in accepted), f"{words}: {done.stderr}"
        return done.stdout.strip()

    def state_of(self, job: int | str) -> str:
        """Returns the states of the tasks of a job, e.g. `COMPLETED`, sorted and separated by spaces."""
        lines = self.call("scontrol", "show", "job", job, "--oneliner").splitlines()
        states = {word.removeprefix("JobState=") for line in lines for word in line.split() if "JobState=" in word}
        return " ".join(sorted(states))

    def wait(self, condition: Callable[[], bool], what: str, within_s: float = 900.0) -> None:
        """Waits for a condition; the time limit only guards against a hang."""
        end = time.monotonic() + within_s
        while not condition():
            assert time.monotonic() < end, f"timed out waiting for {what}\n{self.call('squeue', '--all')}"
            time.sleep(0.5)

    @contextmanager
    def without(self, *nodes: str) -> Iterator[None]:
        """Drains some nodes inside the `with` block, so no task starts on them."""
        self.call("scontrol", "update", f"nodename={','.join(nodes)}", "state=drain", "reason=test")
        try:
            yield
        finally:
            self.call("scontrol", "update", f"nodename={','.join(nodes)}", "state=resume")

    @contextmanager
    def frozen(self, task: str, node: str) -> Iterator[None]:
        """Stops the simulation of a task inside the `with` block, so the task cannot finish its job."""
        number = re.search(r"JobId=(\d+)", self.call("scontrol", "show", "job", task))
        assert number is not None, task
        pids = [
            pid
            for pid in _task_processes(f"{self._folder}/spool-{node}/job{int(number[1]):05}/")
            if "workers.sim.simulate" in Path(f"/proc/{pid}/cmdline").read_text()
        ]
        _signal_all(pids, signal.SIGSTOP)
        try:
            yield
        finally:
            _signal_all(pids, signal.SIGCONT)

    def kill_node(self, name: str) -> None:
        """Kills the daemon of a node and its tasks, as a power failure does, and sets the node's state to down."""
        process = self._processes.pop(name)
        process.kill()
        process.wait()
        _signal_all(_task_processes(f"{self._folder}/spool-{name}"), signal.SIGKILL)
        self.call("scontrol", "update", f"nodename={name}", "state=down", "reason=test")

    def start_node(self, name: str) -> None:
        """Starts the daemon of a node and lets Slurm use the node again."""
        self._start("slurmd", "-D", "-N", name, name=name)
        self.call("scontrol", "update", f"nodename={name}", "state=resume")

    def _start_all(self) -> None:
        munge = self._folder / "munge"
        munge.mkdir(mode=0o755)
        (munge / "key").write_bytes(secrets.token_bytes(64))
        (munge / "key").chmod(0o400)
        ports = [free_endpoint().rpartition(":")[2] for _ in range(NODES + 1)]
        text = _CONFIGURATION.format(host=socket.gethostname(), ports=ports, folder=self._folder, cores=CORES)
        (self._folder / "slurm.conf").write_text(text)
        (self._folder / "state").mkdir()
        files = [f"--{name}-file={munge / name}" for name in ("key", "pid", "log", "seed")]
        self._start("munged", "--foreground", "--force", f"--socket={munge / 'socket'}", *files)
        self.wait_for_file(munge / "socket")
        self._start("slurmctld", "-D")
        for number in range(1, NODES + 1):
            self._start("slurmd", "-D", "-N", f"n{number}", name=f"n{number}")
        self.wait(self._is_ready, "three idle nodes", 60.0)

    def wait_for_file(self, path: Path) -> None:
        end = time.monotonic() + 60
        while not path.exists():
            assert time.monotonic() < end, f"timed out waiting for {path}"
            time.sleep(0.05)

    def _is_ready(self) -> bool:
        done = subprocess.run(
            ["sinfo", "--noheader", "--format=%D %t"], env=self.environment, capture_output=True, text=True
        )
        return f"{NODES} idle" in done.stdout

    def _start(self, program: str, *words: str, name: str | None = None) -> None:
        log = (self._folder / f"{name or program}.log").open("wb")
        with log:
            self._processes[name or program] = subprocess.Popen(
                [program, *words], env=self.environment, stdin=subprocess.DEVNULL, stdout=log, stderr=log
            )

    def _end(self) -> None:
        self._kill_tasks()
        for process in reversed(self._processes.values()):
            process.terminate()
        for process in self._processes.values():
            try:
                process.wait(20)
            except subprocess.TimeoutExpired:
                process.kill()
                process.wait()
        self._kill_tasks()  # the controller may have started more tasks

    def _kill_tasks(self) -> None:
        _signal_all(_task_processes(str(self._folder)), signal.SIGKILL)


def _signal_all(pids: Iterable[int], number: int) -> None:
    for pid in pids:
        with contextlib.suppress(ProcessLookupError):  # it ended when an earlier process of the list was killed
            os.kill(pid, number)


def _task_processes(text: str) -> list[int]:
    """Returns the processes of the tasks whose script has a path that contains `text`.

    The step daemons come first in the list, because they must be killed first. A step daemon that is killed later than
    its script reports the end of the task.
    """
    parents: dict[int, int] = {}
    scripts: set[int] = set()
    for entry in Path("/proc").glob("[0-9]*"):
        try:
            pid = int(entry.name)
            parents[pid] = int(entry.joinpath("stat").read_text().rpartition(")")[2].split()[1])
            command = entry.joinpath("cmdline").read_text()
        except (OSError, ValueError):
            continue
        if text in command and "slurm_script" in command:
            scripts.add(pid)
    daemons = {parents[pid] for pid in scripts} - scripts - {1}
    found = set(scripts)
    while more := {pid for pid, parent in parents.items() if parent in found} - found:
        found |= more
    return [*daemons, *(found - daemons)]
