"""A coordinator, gateways and workers as processes, behind wires and on a disk that can be harmed; all restarted."""

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

from schemas.support.closing import Closing
from tests.builders.ports import free_endpoint
from tests.chaos.bundle_maker import BundleMaker
from tests.chaos.disk import Disk
from tests.chaos.fault_span import FaultSpan
from tests.chaos.fork_server import Child, ForkServer
from tests.chaos.wire import Wires

__all__ = ["FAULTY_HOST", "STORM_CRASHES", "ChaosCluster", "ClusterCommands", "fake_commands", "real_commands"]

STORM_CRASHES = 20
"""Budget of crashes of a job in a run in which the simulations of honest hosts are killed."""
FAULTY_HOST = "faulty"
"""Name of the host that damages what it makes; the honest ones are `host-NUMBER`."""
_Process = subprocess.Popen[bytes] | Child
LEASE_S = 2.0
_LEAVES_WITHIN_S = 30.0
"""Generous: how quickly a worker leaves is tested elsewhere, and many cores are harassed here."""
_SERVES_WITHIN_S = 120.0
_CALM_S, _EPISODE_S = 300.0, 10.0


@dataclass(frozen=True)
class ClusterCommands:
    """How the parts are started."""

    episodes: int
    coordinator: Callable[[Path, str], list[str]]
    """(root, endpoint) -> command line; the dataset lies in `root/out`."""
    worker: Callable[[Path, str, str], list[str]]
    """(folder of the host, endpoints, name of a kitchen) -> command line."""
    longest_s: float
    """How long a round may take."""
    has_small_disk: bool
    """Whether the coordinator works on a disk of a few megabytes."""
    modules: tuple[str, ...] = ()
    """What a nursery imports for all of them; without any each is a command of its own."""
    gateways: int = 0
    gateway: Callable[[Path, str, str], list[str]] | None = None
    """(its directory, endpoint of the core, endpoint) -> command line; its name is that of the directory."""
    faulty_worker: Callable[[Path, str, str, float], list[str]] | None = None
    """As `worker`, and the share of the attempts that it damages."""
    crashes: int = STORM_CRASHES
    """Budget of crashes of a job. With the product's default, simulations of honest hosts must not be killed."""


def fake_commands(
    episodes: int, longest_s: float, gateways: int = 0, checkpoint_s: float = 30.0, crashes: int = STORM_CRASHES
) -> ClusterCommands:
    """Returns the real parts around a simulation without physics: the protocol is on trial.

    Args:
        episodes: of the run.
        longest_s: how long a simulation may take.
        gateways: that the workers are connected to; without any they are to the coordinator.
        checkpoint_s: pause between two writings of the tables.
        crashes: budget of crashes of a job.
    """

    def worker(folder: Path, endpoints: str, script: str, *words: object) -> list[str]:
        simulation = (sys.executable, "-I", "-S", Path(__file__).with_name(script), longest_s)
        return _module("tests.builders.worker", "--host", folder.name, endpoints, folder, 2, *simulation, *words)

    return ClusterCommands(
        episodes,
        lambda root, endpoint: _module(
            "tests.builders.room_coordinator", root, episodes, endpoint, LEASE_S, checkpoint_s, crashes
        ),
        lambda folder, endpoints, kitchen: worker(folder, endpoints, "light_simulation.py", kitchen),
        longest_s=_CALM_S + _EPISODE_S * episodes,
        has_small_disk=True,
        modules=("tests.builders.room_coordinator", "tests.builders.worker", "tests.builders.room_gateway"),
        gateways=gateways,
        gateway=lambda folder, core, endpoint: _module(
            "tests.builders.room_gateway", folder, folder.name, core, endpoint
        ),
        faulty_worker=lambda folder, endpoints, kitchen, share: worker(
            folder, endpoints, "faulty_host.py", kitchen, share
        ),
        crashes=crashes,
    )


def real_commands(plan: Path, episodes: int) -> ClusterCommands:
    """Returns the installed command line with physics and renderer, everything as users have it."""
    return ClusterCommands(
        episodes,
        lambda root, endpoint: _module(
            *("factory", "coordinator", "start", plan, "--out", root / "out", "--listen", endpoint),
            *("--lease", 3 * LEASE_S, "--stay"),
        ),
        lambda folder, endpoint, _kitchen: _module(
            *("factory", "worker", "--connect", endpoint, "--cores", 1, "--spool", folder / "spool", "--wait", 600)
        ),
        longest_s=1200.0,
        has_small_disk=False,
    )


def _module(name: str, *words: object) -> list[str]:
    return [sys.executable, "-m", name, *map(str, words)]


class ChaosCluster(Closing):
    """Everybody who works for one run; a context manager whose exit leaves nobody behind.

    Args:
        root: where to work.
        cast: how to start them.
        workers: how many hosts.
        disk: the coordinator's; `None` for an ordinary folder.
        damage: share of the attempts that a faulty host, one more than `workers`, damages; 0 for no faulty host.
    """

    def __init__(
        self, root: Path, cast: ClusterCommands, workers: int, disk: Disk | None = None, damage: float = 0.0
    ) -> None:
        self.root, self.cast, self.disk = root, cast, disk
        self._honest, self._damage = workers, damage
        self.log = root / "log"
        self.place = disk.path if disk is not None and cast.has_small_disk else root
        self.violations: list[str] = []
        self.restarts: Counter[str] = Counter()
        self._started: list[subprocess.Popen[bytes]] = []
        self._endpoint = free_endpoint()
        self._doors = [free_endpoint() for _ in range(cast.gateways)]
        self._thaw: dict[_Process, float] = {}
        """Who is frozen -> until when."""
        self._back: dict[_Process, float] = {}
        """Whom we ended -> when another takes its place."""
        self._deaf: dict[_Process, float] = {}
        """A worker told to leave -> when it counts as deaf."""
        self._stack = ExitStack()
        doors = self._doors or [self._endpoint]
        self.wires = self._stack.enter_context(Wires([doors] * (workers + (damage > 0))))
        self._kitchen = self._stack.enter_context(BundleMaker())
        preload = disk.preload if disk is not None else {}
        self._nursery = self._stack.enter_context(ForkServer(cast.modules, preload)) if cast.modules else None
        self._stack.callback(self._kill_all)
        self.coordinator = self._start_coordinator()
        self.gateways = [self._start_gateway(number) for number in range(cast.gateways)]
        self.workers = [self._start_worker(number) for number in range(workers + (damage > 0))]

    @property
    def out(self) -> Path:
        """The dataset."""
        return self.place / "out"

    @property
    def stores(self) -> list[Path]:
        """The directories of the gateways."""
        return [self.root / f"gw{number}" for number in range(self.cast.gateways)]

    @property
    def doors(self) -> list[str]:
        """Endpoints that workers connect to, without a relay."""
        return self._doors or [self._endpoint]

    @property
    def everybody(self) -> tuple[_Process, ...]:
        """Every process, in the order in which they are asked to leave."""
        return (*self.workers, *self.gateways, self.coordinator)

    def archived(self) -> dict[int, str]:
        """Returns the content digest of every archived episode."""
        return dict(self.query("select idx, content_digest from episodes"))

    def leased(self) -> int:
        """Returns how many jobs are in work."""
        return sum(count for (count,) in self.query("select count(*) from jobs where state = 'leased'"))

    def outcomes(self) -> Counter[str]:
        """Returns the attempts by outcome."""
        return Counter(dict(self.query("select outcome, count(*) from attempts group by outcome")))

    def query(self, sql: str) -> list[tuple]:  # type: ignore[type-arg]
        """Asks the ledger; nothing while there is none that can be read, or while one who is frozen holds it."""
        path = self.out / "ledger.db"
        if not path.exists():
            return []
        try:
            with closing(sqlite3.connect(f"file:{path}?mode=ro", uri=True, timeout=0.5)) as ledger:
                return ledger.execute(sql).fetchall()
        except sqlite3.DatabaseError:  # it is busy, damaged, or the coordinator is about to make the tables
            return []

    def kill_worker(self, number: int) -> FaultSpan | None:
        """Kills a supervisor at work; another takes its place."""
        return self._kill(self.workers[number], 0.0) if self._is_at_work(number) else None

    def dismiss_worker(self, number: int) -> FaultSpan | None:
        """Asks a supervisor at work to leave; another takes its place once it has left."""
        worker = self.workers[number]
        if not self._is_at_work(number) or worker in self._deaf:
            return None
        worker.send_signal(signal.SIGTERM)
        self._back[worker] = 0.0
        self._deaf[worker] = time.monotonic() + _LEAVES_WITHIN_S
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
        """Kills a coordinator that serves; it starts again after a while."""
        return self._kill(self.coordinator, pause_s) if self._serves(self.coordinator, self._endpoint) else None

    def kill_gateway(self, number: int, pause_s: float) -> FaultSpan | None:
        """Kills a gateway that serves; it starts again after a while."""
        victim = self.gateways[number]
        return self._kill(victim, pause_s) if self._serves(victim, self._doors[number]) else None

    def freeze_worker(self, number: int, seconds: float) -> FaultSpan | None:
        """Stops a supervisor at work; `tend` lets it go on after that time."""
        return self._freeze(self.workers[number], seconds) if self._is_at_work(number) else None

    def freeze_coordinator(self, seconds: float) -> FaultSpan | None:
        """Stops a coordinator that serves."""
        return self._freeze(self.coordinator, seconds) if self._serves(self.coordinator, self._endpoint) else None

    def freeze_gateway(self, number: int, seconds: float) -> FaultSpan | None:
        """Stops a gateway that serves."""
        victim = self.gateways[number]
        return self._freeze(victim, seconds) if self._serves(victim, self._doors[number]) else None

    def tend(self, *, everybody: bool = False) -> None:
        """Thaws who was frozen long enough, and starts again who has left before its time, as an init system would.

        Args:
            everybody: thaw and start again at once, however long they were to be away.
        """
        self._thaw_due(everybody=everybody)
        now = float("inf") if everybody else time.monotonic()
        for number, worker in enumerate(self.workers):
            self._end_if_deaf(worker)
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
                self._note_given_up()
            self.coordinator = self._start_coordinator()

    def _is_due(self, process: _Process, now: float) -> bool:
        return process.poll() is not None and self._back.get(process, 0.0) <= now

    def _note_given_up(self) -> None:
        if self._was_full:
            self.restarts["coordinator, disk full"] += 1
        else:
            self.violations.append(f"the coordinator ended by itself with {self.coordinator.poll()}")

    _was_full = False

    def note_full_disk(self) -> None:
        """From now on the coordinator may give up and be started again: a ledger cannot be opened on a full disk."""
        self._was_full = True

    def end(self) -> None:
        """Asks everybody to leave; who does not is a violation."""
        deadline = time.monotonic() + _SERVES_WITHIN_S
        while not self._is_whole():  # who was killed last puts in order what it left when it starts
            if time.monotonic() > deadline:
                self.violations.append(f"not everybody serves again within {_SERVES_WITHIN_S:g} s")
                break
            self.tend(everybody=True)
            time.sleep(0.05)
        for process in self.everybody:
            process.send_signal(signal.SIGTERM)
        for process in self.everybody:
            self._await(process, "at the end")
        if self.coordinator.poll() != 0:
            self.violations.append(f"the coordinator ends with {self.coordinator.poll()}")

    def close(self) -> None:
        """Closes what was opened."""
        self._stack.close()

    def _thaw_due(self, *, everybody: bool = False) -> None:
        now = time.monotonic()
        for process in [process for process, until in self._thaw.items() if everybody or until < now]:
            del self._thaw[process]
            if process.poll() is None:
                process.send_signal(signal.SIGCONT)

    def _is_at_work(self, number: int) -> bool:
        worker = self.workers[number]
        return worker.poll() is None and worker not in self._thaw and bool(_children(worker.pid))

    def _is_whole(self) -> bool:
        doors = zip(self.gateways, self._doors, strict=True)
        return all(self._serves(process, door) for process, door in [(self.coordinator, self._endpoint), *doors])

    def _serves(self, process: _Process, endpoint: str) -> bool:
        if process.poll() is not None or process in self._thaw:
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
        self._thaw.pop(victim, None)
        self._back[victim] = time.monotonic() + pause_s
        return FaultSpan(1)

    def _freeze(self, process: _Process, seconds: float) -> FaultSpan:
        process.send_signal(signal.SIGSTOP)
        self._thaw[process] = time.monotonic() + seconds
        return FaultSpan(1)

    def _end_if_deaf(self, worker: _Process) -> None:
        if worker.poll() is None and self._deaf.get(worker, float("inf")) < time.monotonic():
            self._await(worker, "dismissed", within_s=0.0)

    def _await(self, process: _Process, who: str, within_s: float = _LEAVES_WITHIN_S) -> None:
        deadline = time.monotonic() + within_s
        while process.poll() is None and time.monotonic() < deadline:
            self._thaw_due()  # it may wait for somebody who is frozen
            time.sleep(0.02)
        if process.poll() is None:
            self.violations.append(f"deaf to signals for {_LEAVES_WITHIN_S:g} s ({who}): {process.args!r}")
            process.kill()
            process.wait()

    def _kill_all(self) -> None:
        for process in self._started:
            if process.poll() is None:
                process.kill()
                process.wait()

    def _start_coordinator(self) -> _Process:
        extra = self.disk.preload | self.disk.environment if self.disk is not None else {}
        return self._spawn(self.cast.coordinator(self.place, self._endpoint), extra)

    def _start_gateway(self, number: int) -> _Process:
        assert self.cast.gateway is not None
        return self._spawn(self.cast.gateway(self.stores[number], self._endpoint, self._doors[number]), {})

    def _start_worker(self, number: int) -> _Process:
        doors = ",".join(self.wires.endpoints[number])
        if number >= self._honest:
            assert self.cast.faulty_worker is not None
            folder = self.root / FAULTY_HOST
            return self._spawn(self.cast.faulty_worker(folder, doors, self._kitchen.name, self._damage), {})
        return self._spawn(self.cast.worker(self.root / f"host-{number}", doors, self._kitchen.name), {})

    def _spawn(self, command: Sequence[str], extra: dict[str, str]) -> _Process:
        if self._nursery is not None:
            _, _, module, *words = command
            return self._nursery.start(module, words, self.log, extra)
        with self.log.open("ab") as log:
            process = subprocess.Popen(
                command, stdout=log, stderr=log, stdin=subprocess.DEVNULL, env=os.environ | extra
            )
        self._started.append(process)
        return process


def _children(pid: int) -> list[int]:
    """Returns the living processes that any thread of a process has started."""
    try:
        lists = [path.read_text() for path in Path(f"/proc/{pid}/task").glob("*/children")]
    except (FileNotFoundError, ProcessLookupError):
        return []
    return [child for text in lists for child in map(int, text.split()) if _lives(child)]


def _lives(pid: int) -> bool:
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except (FileNotFoundError, ProcessLookupError):
        return False
