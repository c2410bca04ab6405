"""A coordinator, gateways and workers as processes, behind wires and on a disk that can be harmed; all restarted."""

from __future__ import annotations

import os
import random
import signal
import sqlite3
import subprocess
import sys
import time
from collections import Counter
from collections.abc import Callable, Sequence
from contextlib import ExitStack, closing
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import Self

from tests.builders.fake_coordinator import free_endpoint
from tests.chaos.disk import Disk
from tests.chaos.wire import Wires

__all__ = ["Cast", "Party", "fake_cast", "real_cast"]

LEASE_S = 2.0
_LEAVES_WITHIN_S = 30.0
"""Generous: how quickly a worker leaves is tested elsewhere, and many cores are harassed here."""


@dataclass(frozen=True)
class Cast:
    """How the parts are started."""

    episodes: int
    coordinator: Callable[[Path, str], list[str]]
    """(root, endpoint) -> command line; the dataset lies in `root/out`."""
    worker: Callable[[Path, str], list[str]]
    """(folder of the host, endpoint) -> command line."""
    longest_s: float
    """How long a round may take."""
    has_small_disk: bool
    """Whether the coordinator works on a disk of a few megabytes."""
    gateways: int = 0
    gateway: Callable[[Path, str, str], list[str]] | None = None
    """(its directory, endpoint of the core, endpoint) -> command line; its name is that of the directory."""


def fake_cast(episodes: int, longest_s: float, gateways: int = 0) -> Cast:
    """Returns the real parts around a simulation without physics: the protocol is on trial.

    Args:
        episodes: of the run.
        longest_s: how long a simulation may take.
        gateways: that the workers are connected to; without any they are to the coordinator.
    """
    simulation = [sys.executable, "-m", "tests.builders.small_simulation", str(longest_s)]
    return Cast(
        episodes,
        lambda root, endpoint: _module("tests.builders.room_coordinator", root, episodes, endpoint, LEASE_S),
        lambda folder, endpoint: [*_module("tests.builders.worker", endpoint, folder, 2), *simulation],
        longest_s=300.0,
        has_small_disk=True,
        gateways=gateways,
        gateway=lambda folder, core, endpoint: _module(
            "tests.builders.room_gateway", folder, folder.name, core, endpoint
        ),
    )


def real_cast(plan: Path, episodes: int) -> Cast:
    """Returns the installed command line with physics and renderer, everything as users have it."""
    return Cast(
        episodes,
        lambda root, endpoint: _module(
            *("factory", "coordinator", "start", plan, "--out", root / "out", "--listen", endpoint),
            *("--lease", 3 * LEASE_S, "--stay"),
        ),
        lambda folder, endpoint: _module(
            *("factory", "worker", "--connect", endpoint, "--cores", 1, "--spool", folder / "spool", "--wait", 600)
        ),
        longest_s=1200.0,
        has_small_disk=False,
    )


def _module(name: str, *words: object) -> list[str]:
    return [sys.executable, "-m", name, *map(str, words)]


class Party:
    """Everybody who works for one run; a context manager whose exit leaves nobody behind.

    Args:
        root: where to work.
        cast: how to start them.
        workers: how many hosts.
        disk: the coordinator's; `None` for an ordinary folder.
    """

    def __init__(self, root: Path, cast: Cast, workers: int, disk: Disk | None = None) -> None:
        self.root, self.cast, self.disk = root, cast, disk
        self.log = root / "log"
        self.place = disk.path if disk is not None and cast.has_small_disk else root
        self.violations: list[str] = []
        self.restarts: Counter[str] = Counter()
        self._started: list[subprocess.Popen[bytes]] = []
        self._endpoint = free_endpoint()
        self._doors = [free_endpoint() for _ in range(cast.gateways)]
        self._thaw: dict[int, float] = {}
        self._stack = ExitStack()
        doors = self._doors or [self._endpoint]
        self.wires = self._stack.enter_context(Wires([doors[n % len(doors)] for n in range(workers)]))
        self._stack.callback(self._kill_all)
        self.coordinator = self._start_coordinator()
        self.gateways = [self._start_gateway(number) for number in range(cast.gateways)]
        self.workers = [self._start_worker(number) for number in range(workers)]

    @property
    def out(self) -> Path:
        """The dataset."""
        return self.place / "out"

    @property
    def stores(self) -> list[Path]:
        """The directories of the gateways."""
        return [self.root / f"gw{number}" for number in range(self.cast.gateways)]

    @property
    def everybody(self) -> tuple[subprocess.Popen[bytes], ...]:
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
        """Asks the ledger; nothing while there is none yet, or while one who is frozen holds it."""
        path = self.out / "ledger.db"
        if not path.exists():
            return []
        try:
            with closing(sqlite3.connect(f"file:{path}?mode=ro", uri=True, timeout=0.5)) as ledger:
                return ledger.execute(sql).fetchall()
        except sqlite3.OperationalError:  # it is busy, or the coordinator is about to make the tables
            return []

    def kill_worker(self, number: int, how: signal.Signals) -> None:
        """Ends a supervisor and starts another in its place, as an init system would."""
        victim = self.workers[number]
        victim.send_signal(how)
        victim.send_signal(signal.SIGCONT)
        self._await(victim, f"worker {number}")
        self._thaw.pop(victim.pid, None)
        self.workers[number] = self._start_worker(number)

    def harm_simulation(self, number: int, how: signal.Signals, rng: random.Random) -> None:
        """Signals one of a supervisor's simulations."""
        victims = _children(self.workers[number].pid)
        if victims:
            os.kill(rng.choice(victims), how)

    def freeze(self, process: subprocess.Popen[bytes], seconds: float) -> None:
        """Stops a process; `tend` lets it go on after that time."""
        if process.poll() is None:
            process.send_signal(signal.SIGSTOP)
            self._thaw[process.pid] = time.monotonic() + seconds

    def kill_coordinator(self, pause_s: float) -> None:
        """Kills the coordinator and starts it again after a while."""
        self.coordinator.kill()
        self.coordinator.wait()
        self._thaw.pop(self.coordinator.pid, None)
        time.sleep(pause_s)
        self.coordinator = self._start_coordinator()

    def kill_gateway(self, number: int, pause_s: float) -> None:
        """Kills a gateway and starts it again after a while."""
        victim = self.gateways[number]
        victim.kill()
        victim.wait()
        self._thaw.pop(victim.pid, None)
        time.sleep(pause_s)
        self.gateways[number] = self._start_gateway(number)

    def tend(self, *, everybody: bool = False) -> None:
        """Thaws who was frozen long enough, and starts again who has left with a failure, as an init system would."""
        self._thaw_due(everybody=everybody)
        for number, worker in enumerate(self.workers):
            if worker.poll() not in {None, 0}:
                self.restarts["worker"] += 1
                self.workers[number] = self._start_worker(number)
        for number, gateway in enumerate(self.gateways):
            if gateway.poll() is not None:
                self.violations.append(f"gateway {number} ended by itself with {gateway.poll()}")
                self.gateways[number] = self._start_gateway(number)
        if self.coordinator.poll() is not None:
            if self.disk is None or not self._was_full:
                self.violations.append(f"the coordinator ended by itself with {self.coordinator.poll()}")
            self.restarts["coordinator, disk full"] += 1
            self.coordinator = self._start_coordinator()

    _was_full = False

    def note_full_disk(self) -> None:
        """From now on the coordinator may give up and be started again: a ledger cannot be opened on a full disk."""
        self._was_full = True

    def end(self) -> None:
        """Asks everybody to leave; who does not is a violation."""
        self.tend(everybody=True)
        for process in self.everybody:
            process.send_signal(signal.SIGTERM)
        for process in self.everybody:
            self._await(process, "at the end")

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._stack.close()

    def _thaw_due(self, *, everybody: bool = False) -> None:
        for process in self.everybody:
            if everybody or self._thaw.get(process.pid, float("inf")) < time.monotonic():
                self._thaw.pop(process.pid, None)
                if process.poll() is None:
                    process.send_signal(signal.SIGCONT)

    def _await(self, process: subprocess.Popen[bytes], who: str) -> None:
        deadline = time.monotonic() + _LEAVES_WITHIN_S
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

    def _start_coordinator(self) -> subprocess.Popen[bytes]:
        extra = self.disk.environment if self.disk is not None else {}
        return self._spawn(self.cast.coordinator(self.place, self._endpoint), extra)

    def _start_gateway(self, number: int) -> subprocess.Popen[bytes]:
        assert self.cast.gateway is not None
        return self._spawn(self.cast.gateway(self.stores[number], self._endpoint, self._doors[number]), {})

    def _start_worker(self, number: int) -> subprocess.Popen[bytes]:
        """Starts a worker that reaches one door through its wire and, with gateways, the others without any."""
        others = [door for place, door in enumerate(self._doors) if place != number % len(self._doors)]
        doors = ",".join((self.wires.endpoints[number], *others))
        return self._spawn(self.cast.worker(self.root / f"host-{number}", doors), {})

    def _spawn(self, command: Sequence[str], extra: dict[str, str]) -> subprocess.Popen[bytes]:
        with self.log.open("ab") as log:
            process = subprocess.Popen(
                command, stdout=log, stderr=log, stdin=subprocess.DEVNULL, env=os.environ | extra
            )
        self._started.append(process)
        return process


def _children(pid: int) -> list[int]:
    """Returns the processes that any thread of a process has started."""
    try:
        lists = [path.read_text() for path in Path(f"/proc/{pid}/task").glob("*/children")]
    except (FileNotFoundError, ProcessLookupError):
        return []
    return [int(child) for text in lists for child in text.split()]
