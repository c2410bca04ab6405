"""Runs a coordinator, gateways and workers as processes, injects faults into them and restarts them."""

from __future__ import annotations

import os
import random
import signal
import socket
import sqlite3
import subprocess
import sys
import time
from collections import Counter
from collections.abc import Callable, Sequence
from contextlib import ExitStack, closing
from dataclasses import dataclass
from pathlib import Path

from schemas.plan import Plan
from schemas.support.closing import Closing
from schemas.terms import Recording
from tests.builders.ledger import room_plan
from tests.builders.ports import free_endpoint
from tests.chaos.bundle_maker import BundleMaker
from tests.chaos.disk import Disk
from tests.chaos.fault_span import FaultSpan
from tests.chaos.wire import Wires

LARGE_CRASH_BUDGET = 20
"""Permitted crashes of a job in a run in which the simulations of honest hosts are killed."""
FAULTY_HOST = "faulty"
"""Name of the host that damages its bundles; honest hosts are named `host-NUMBER`."""
_Process = subprocess.Popen[bytes]
LEASE_S = 2.0
_EXITS_WITHIN_S = 30.0
"""Time within which a worker must exit after SIGTERM, seconds; long, because the machine is overloaded in a campaign.
Other tests check how quickly a worker exits."""
_SERVES_WITHIN_S = 120.0
_BASE_S, _EPISODE_S = 300.0, 10.0


@dataclass(frozen=True)
class ClusterCommands:
    """Commands that start the processes of a run, and the properties of the run."""

    episodes: int
    coordinator: Callable[[Path, str], list[str]]
    """(root, endpoint) -> command line; the dataset is written to `root/out`."""
    worker: Callable[[Path, str, str], list[str]]
    """(folder of the host, endpoints, socket name of the `BundleMaker`) -> command line."""
    longest_s: float
    """Timeout of a round, seconds."""
    has_small_disk: bool
    """Whether the coordinator keeps its files on the small test disk, if there is one."""
    gateways: int = 0
    gateway: Callable[[Path, str, str], list[str]] | None = None
    """(directory, endpoint of the coordinator, endpoint) -> command line; the gateway is named like the directory."""
    faulty_worker: Callable[[Path, str, str, float], list[str]] | None = None
    """Like `worker`, with one more argument: the share of damaged attempts."""
    crashes: int = LARGE_CRASH_BUDGET
    """Permitted crashes of a job. If less than `LARGE_CRASH_BUDGET`, no fault kills simulations of honest hosts."""
    record: Recording = Recording.FRAMES
    """What an episode stores; episodes of states are packed into shards."""

    @property
    def plan(self) -> Plan:
        """Plan of a run with a synthetic scene."""
        return room_plan(self.episodes, self.record, crashes=self.crashes)


def fake_commands(
    episodes: int,
    longest_s: float,
    gateways: int = 0,
    checkpoint_s: float = 30.0,
    crashes: int = LARGE_CRASH_BUDGET,
    record: Recording = Recording.FRAMES,
) -> ClusterCommands:
    """Returns commands of real processes with a simulation without physics, to test the protocol.

    Args:
        episodes: number of episodes of the run.
        longest_s: longest duration of a simulation, seconds.
        gateways: number of gateways; with 0 the workers connect to the coordinator.
        checkpoint_s: interval between two writes of the tables, seconds.
        crashes: permitted crashes of a job.
        record: what an episode stores.
    """

    def worker(folder: Path, endpoints: str, script: str, *words: object) -> list[str]:
        simulation = (sys.executable, "-I", "-S", Path(__file__).with_name(script), longest_s)
        return _module("tests.builders.worker", "--host", folder.name, endpoints, folder, 2, *simulation, *words)

    return ClusterCommands(
        episodes,
        lambda root, endpoint: _module(
            "tests.builders.room_coordinator", root, episodes, endpoint, LEASE_S, checkpoint_s, crashes, record
        ),
        lambda folder, endpoints, bundle_maker: worker(folder, endpoints, "light_simulation.py", bundle_maker),
        longest_s=_BASE_S + _EPISODE_S * episodes,
        has_small_disk=True,
        gateways=gateways,
        gateway=lambda folder, core, endpoint: _module(
            "tests.builders.room_gateway", folder, folder.name, core, endpoint
        ),
        faulty_worker=lambda folder, endpoints, bundle_maker, share: worker(
            folder, endpoints, "faulty_host.py", bundle_maker, share
        ),
        crashes=crashes,
        record=record,
    )


def real_commands(plan: Path, episodes: int) -> ClusterCommands:
    """Returns commands of the installed `factory` with physics and renderer."""
    return ClusterCommands(
        episodes,
        lambda root, endpoint: _module(
            *("factory", "coordinator", "start", plan, "--out", root / "out", "--listen", endpoint),
            *("--lease", 3 * LEASE_S, "--stay"),
        ),
        lambda folder, endpoint, _bundle_maker: _module(
            *("factory", "worker", "--connect", endpoint, "--cores", 1, "--spool", folder / "spool"),
            *("--connect-timeout", 600),
        ),
        longest_s=1200.0,
        has_small_disk=False,
    )


def _module(name: str, *words: object) -> list[str]:
    return [sys.executable, "-m", name, *map(str, words)]


class ChaosCluster(Closing):
    """All processes of one run. Context manager: exit ends every process.

    Args:
        root: working directory.
        commands: commands that start the processes.
        workers: number of hosts.
        disk: disk of the coordinator; `None` for an ordinary folder.
        damage: share of its attempts that an additional faulty host damages; with 0, no faulty host is added.
    """

    def __init__(
        self, root: Path, commands: ClusterCommands, workers: int, disk: Disk | None = None, damage: float = 0.0
    ) -> None:
        self.root, self.commands, self.disk = root, commands, disk
        self._honest, self._damage = workers, damage
        self.log = root / "log"
        self.place = disk.path if disk is not None and commands.has_small_disk else root
        self.violations: list[str] = []
        self.restarts: Counter[str] = Counter()
        self._started: list[subprocess.Popen[bytes]] = []
        self._endpoint = free_endpoint()
        self._gateway_endpoints = [free_endpoint() for _ in range(commands.gateways)]
        self._resumes_at: dict[_Process, float] = {}
        """Frozen process -> time at which it resumes."""
        self._back: dict[_Process, float] = {}
        """Process ended by a fault -> time at which its replacement starts."""
        self._unresponsive: dict[_Process, float] = {}
        """Worker that got SIGTERM -> time at which it counts as unresponsive if it has not exited."""
        self._stack = ExitStack()
        endpoints = self.endpoints
        self.wires = self._stack.enter_context(Wires([endpoints] * (workers + (damage > 0))))
        self._bundle_maker = self._stack.enter_context(BundleMaker())
        self._stack.callback(self._kill_all)
        self.coordinator = self._start_coordinator()
        self.gateways = [self._start_gateway(number) for number in range(commands.gateways)]
        self.workers = [self._start_worker(number) for number in range(workers + (damage > 0))]

    @property
    def out(self) -> Path:
        """Directory of the dataset."""
        return self.place / "out"

    @property
    def stores(self) -> list[Path]:
        """Directories of the gateways."""
        return [self.root / f"gw{number}" for number in range(self.commands.gateways)]

    @property
    def endpoints(self) -> list[str]:
        """Endpoints that workers connect to, without a relay."""
        return self._gateway_endpoints or [self._endpoint]

    @property
    def processes(self) -> tuple[_Process, ...]:
        """Every process, in the order of shutdown."""
        return (*self.workers, *self.gateways, self.coordinator)

    def archived(self) -> dict[int, str]:
        """Returns the content digest of every archived episode."""
        return dict(self.query("select idx, content_digest from episodes"))

    def leased(self) -> int:
        """Returns the number of leased jobs."""
        return sum(count for (count,) in self.query("select count(*) from jobs where state = 'leased'"))

    def outcomes(self) -> Counter[str]:
        """Returns the number of attempts by outcome."""
        return Counter(dict(self.query("select outcome, count(*) from attempts group by outcome")))

    def query(self, sql: str) -> list[tuple]:  # type: ignore[type-arg]
        """Queries the ledger; returns no rows while it is missing, unreadable or locked by a frozen process."""
        path = self.out / "ledger.db"
        if not path.exists():
            return []
        try:
            with closing(sqlite3.connect(f"file:{path}?mode=ro", uri=True, timeout=0.5)) as ledger:
                return ledger.execute(sql).fetchall()
        except sqlite3.DatabaseError:  # the ledger is busy, damaged, or without tables yet
            return []

    def kill_worker(self, number: int) -> FaultSpan | None:
        """Kills a supervisor that runs simulations; `tend` starts a replacement."""
        return self._kill(self.workers[number], 0.0) if self._is_at_work(number) else None

    def terminate_worker(self, number: int) -> FaultSpan | None:
        """Sends SIGTERM to a supervisor that runs simulations; `tend` starts a replacement after its exit."""
        worker = self.workers[number]
        if not self._is_at_work(number) or worker in self._unresponsive:
            return None
        worker.send_signal(signal.SIGTERM)
        self._back[worker] = 0.0
        self._unresponsive[worker] = time.monotonic() + _EXITS_WITHIN_S
        return FaultSpan(1)

    def kill_simulation(self, number: int, rng: random.Random) -> FaultSpan | None:
        """Kills one of a supervisor's simulations."""
        victims = _children(self.workers[number].pid)
        if not victims:
            return None
        try:
            os.kill(rng.choice(victims), signal.SIGKILL)
        except ProcessLookupError:
            return None
        return FaultSpan(1)

    def kill_coordinator(self, pause_s: float) -> FaultSpan | None:
        """Kills a serving coordinator; `tend` restarts it after a pause."""
        return self._kill(self.coordinator, pause_s) if self._serves(self.coordinator, self._endpoint) else None

    def kill_packing_coordinator(self, wait_s: float, delay_s: float) -> FaultSpan | None:
        """Kills the coordinator `delay_s` after it starts a shard; `None` if it starts no shard within `wait_s`."""
        deadline = time.monotonic() + wait_s
        while not any((self.out / ".staging").glob("shard*.part")):
            if time.monotonic() > deadline:
                return None
            time.sleep(0.001)
        time.sleep(delay_s)
        return self.kill_coordinator(0.0)

    def kill_gateway(self, number: int, pause_s: float) -> FaultSpan | None:
        """Kills a serving gateway; `tend` restarts it after a pause."""
        victim = self.gateways[number]
        return self._kill(victim, pause_s) if self._serves(victim, self._gateway_endpoints[number]) else None

    def freeze_worker(self, number: int, seconds: float) -> FaultSpan | None:
        """Sends SIGSTOP to a supervisor that runs simulations; `tend` resumes it after `seconds`."""
        return self._freeze(self.workers[number], seconds) if self._is_at_work(number) else None

    def freeze_coordinator(self, seconds: float) -> FaultSpan | None:
        """Sends SIGSTOP to a serving coordinator."""
        return self._freeze(self.coordinator, seconds) if self._serves(self.coordinator, self._endpoint) else None

    def freeze_gateway(self, number: int, seconds: float) -> FaultSpan | None:
        """Sends SIGSTOP to a serving gateway."""
        victim = self.gateways[number]
        return self._freeze(victim, seconds) if self._serves(victim, self._gateway_endpoints[number]) else None

    def tend(self, *, at_once: bool = False) -> None:
        """Resumes frozen processes and restarts ended processes after their pauses, as an init system does.

        Args:
            at_once: whether to resume and restart without waiting for the pauses.
        """
        self._resume_due(at_once=at_once)
        now = float("inf") if at_once else time.monotonic()
        for number, worker in enumerate(self.workers):
            self._kill_if_unresponsive(worker)
            if self._is_due(worker, now) and (worker in self._back or worker.poll() != 0):
                self.restarts["worker"] += worker not in self._back
                self.workers[number] = self._start_worker(number)
        for number, gateway in enumerate(self.gateways):
            if self._is_due(gateway, now):
                if gateway not in self._back:
                    self.violations.append(f"gateway {number} ended by itself with {gateway.poll()}")
                self.gateways[number] = self._start_gateway(number)
        if self._is_due(self.coordinator, now):
            if self.coordinator not in self._back:
                self._note_coordinator_exit()
            self.coordinator = self._start_coordinator()

    def _is_due(self, process: _Process, now: float) -> bool:
        return process.poll() is not None and self._back.get(process, 0.0) <= now

    def _note_coordinator_exit(self) -> None:
        if self._was_full:
            self.restarts["coordinator, disk full"] += 1
        else:
            self.violations.append(f"the coordinator ended by itself with {self.coordinator.poll()}")

    _was_full = False

    def note_full_disk(self) -> None:
        """Accepts from now on that the coordinator exits, because a ledger cannot be opened on a full disk."""
        self._was_full = True

    def end(self) -> None:
        """Sends SIGTERM to all processes; a process that does not exit is a violation."""
        deadline = time.monotonic() + _SERVES_WITHIN_S
        while not self._is_whole():  # killed processes clean up when they start again
            if time.monotonic() > deadline:
                self.violations.append(f"not every process serves again within {_SERVES_WITHIN_S:g} s")
                break
            self.tend(at_once=True)
            time.sleep(0.05)
        for process in self.processes:
            process.send_signal(signal.SIGTERM)
        for process in self.processes:
            self._await(process, "at the end")
        if self.coordinator.poll() != 0:
            self.violations.append(f"the coordinator ends with {self.coordinator.poll()}")

    def close(self) -> None:
        """Ends all processes and closes all resources."""
        self._stack.close()

    def _resume_due(self, *, at_once: bool = False) -> None:
        now = time.monotonic()
        for process in [process for process, until in self._resumes_at.items() if at_once or until < now]:
            del self._resumes_at[process]
            if process.poll() is None:
                process.send_signal(signal.SIGCONT)

    def _is_at_work(self, number: int) -> bool:
        worker = self.workers[number]
        return worker.poll() is None and worker not in self._resumes_at and bool(_children(worker.pid))

    def _is_whole(self) -> bool:
        gateways = zip(self.gateways, self._gateway_endpoints, strict=True)
        return all(
            self._serves(process, endpoint) for process, endpoint in [(self.coordinator, self._endpoint), *gateways]
        )

    def _serves(self, process: _Process, endpoint: str) -> bool:
        if process.poll() is not None or process in self._resumes_at:
            return False
        host, _, port = endpoint.removeprefix("tcp/").rpartition(":")
        try:
            socket.create_connection((host, int(port)), timeout=0.5).close()
        except OSError:
            return False
        return True

    def _kill(self, victim: _Process, pause_s: float) -> FaultSpan:
        victim.kill()
        victim.wait()
        self._resumes_at.pop(victim, None)
        self._back[victim] = time.monotonic() + pause_s
        return FaultSpan(1)

    def _freeze(self, process: _Process, seconds: float) -> FaultSpan:
        process.send_signal(signal.SIGSTOP)
        self._resumes_at[process] = time.monotonic() + seconds
        return FaultSpan(1)

    def _kill_if_unresponsive(self, worker: _Process) -> None:
        if worker.poll() is None and self._unresponsive.get(worker, float("inf")) < time.monotonic():
            self._await(worker, "after SIGTERM", within_s=0.0)

    def _await(self, process: _Process, who: str, within_s: float = _EXITS_WITHIN_S) -> None:
        deadline = time.monotonic() + within_s
        while process.poll() is None and time.monotonic() < deadline:
            self._resume_due()  # the process may wait for a frozen process
            time.sleep(0.02)
        if process.poll() is None:
            self.violations.append(f"no exit within {_EXITS_WITHIN_S:g} s of a signal ({who}): {process.args!r}")
            process.kill()
            process.wait()

    def _kill_all(self) -> None:
        for process in self._started:
            if process.poll() is None:
                process.kill()
                process.wait()

    def _start_coordinator(self) -> _Process:
        extra = self.disk.preload | self.disk.environment if self.disk is not None else {}
        return self._spawn(self.commands.coordinator(self.place, self._endpoint), extra)

    def _start_gateway(self, number: int) -> _Process:
        assert self.commands.gateway is not None
        return self._spawn(
            self.commands.gateway(self.stores[number], self._endpoint, self._gateway_endpoints[number]), {}
        )

    def _start_worker(self, number: int) -> _Process:
        endpoints = ",".join(self.wires.endpoints[number])
        if number >= self._honest:
            assert self.commands.faulty_worker is not None
            folder = self.root / FAULTY_HOST
            return self._spawn(
                self.commands.faulty_worker(folder, endpoints, self._bundle_maker.name, self._damage), {}
            )
        return self._spawn(self.commands.worker(self.root / f"host-{number}", endpoints, self._bundle_maker.name), {})

    def _spawn(self, command: Sequence[str], extra: dict[str, str]) -> _Process:
        with self.log.open("ab") as log:
            process = subprocess.Popen(
                command, stdout=log, stderr=log, stdin=subprocess.DEVNULL, env=os.environ | extra
            )
        self._started.append(process)
        return process


def _children(pid: int) -> list[int]:
    """Returns the running child processes of all threads of a process."""
    try:
        lists = [path.read_text() for path in Path(f"/proc/{pid}/task").glob("*/children")]
    except (FileNotFoundError, ProcessLookupError):
        return []
    return [child for text in lists for child in map(int, text.split()) if _is_alive(child)]


def _is_alive(pid: int) -> bool:
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except (FileNotFoundError, ProcessLookupError):
        return False
