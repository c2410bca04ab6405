"""Kills and freezes workers, simulations and the coordinator while a run goes on; nothing may be lost or doubled."""

from __future__ import annotations

import os
import random
import signal
import sqlite3
import subprocess
import sys
import time
from collections import Counter
from contextlib import ExitStack, closing
from pathlib import Path

import pytest

from schemas.digest import dataset_digest
from tests.builders.fake_coordinator import free_endpoint

EPISODES = 30
LEASE_S = 2.0
CHAOS_S = 20.0
LIMIT_S = 120.0


class Scene:
    """A coordinator and its workers, each of which can be killed and started again."""

    def __init__(self, root: Path, workers: int, longest_s: float) -> None:
        self.root, self.longest_s = root, longest_s
        self.endpoint = free_endpoint()
        self.faults: Counter[str] = Counter()
        self._thaw: dict[int, float] = {}
        self.coordinator = self._start_coordinator()
        self.workers = [self._start_worker(number) for number in range(workers)]

    def _start_coordinator(self) -> subprocess.Popen[bytes]:
        arguments = (str(self.root), str(EPISODES), self.endpoint, str(LEASE_S))
        return self._spawn("tests.builders.room_coordinator", *arguments)

    def _start_worker(self, number: int) -> subprocess.Popen[bytes]:
        command = (sys.executable, "-m", "tests.builders.small_simulation", str(self.longest_s))
        return self._spawn("tests.builders.worker", self.endpoint, str(self.root / f"host-{number}"), "2", *command)

    def _spawn(self, *module_and_arguments: str) -> subprocess.Popen[bytes]:
        with (self.root / "log").open("ab") as log:
            return subprocess.Popen([sys.executable, "-m", *module_and_arguments], stdout=log, stderr=log)

    def archived(self) -> dict[int, str]:
        """Returns the content digest of every archived episode."""
        path = self.root / "out" / "ledger.db"
        if not path.exists():
            return {}
        with closing(sqlite3.connect(f"file:{path}?mode=ro", uri=True, timeout=30)) as ledger:
            try:
                return dict(ledger.execute("select idx, content_digest from episodes").fetchall())
            except sqlite3.OperationalError:  # the coordinator is about to make the tables
                return {}

    def events(self) -> Counter[str]:
        with closing(sqlite3.connect(f"file:{self.root / 'out' / 'ledger.db'}?mode=ro", uri=True)) as ledger:
            return Counter(dict(ledger.execute("select outcome, count(*) from attempts group by outcome").fetchall()))

    def leased(self) -> int:
        """Returns how many jobs are in work."""
        path = self.root / "out" / "ledger.db"
        if not path.exists():
            return 0
        with closing(sqlite3.connect(f"file:{path}?mode=ro", uri=True, timeout=30)) as ledger:
            try:
                (count,) = ledger.execute("select count(*) from jobs where state = 'leased'").fetchone()
            except sqlite3.OperationalError:
                return 0
        return int(count)

    def harm(self, rng: random.Random) -> None:
        """One mishap."""
        number = rng.randrange(len(self.workers))
        what = rng.choice(("kill worker", "kill simulation", "freeze worker", "kill coordinator", "stop worker"))
        self.faults[what] += 1
        victim = self.workers[number]
        if what == "kill coordinator":
            self.coordinator.kill()
            self.coordinator.wait()
            time.sleep(rng.uniform(0.0, 0.5))
            self.coordinator = self._start_coordinator()
        elif what == "kill simulation":
            for child in _children(victim.pid)[:1]:
                os.kill(child, signal.SIGKILL)
        elif what == "freeze worker":
            victim.send_signal(signal.SIGSTOP)
            self._thaw[victim.pid] = time.monotonic() + rng.uniform(0.5, 2.0) * LEASE_S
        else:
            victim.send_signal(signal.SIGKILL if what == "kill worker" else signal.SIGTERM)
            victim.send_signal(signal.SIGCONT)
            victim.wait(20)
            self.workers[number] = self._start_worker(number)

    def thaw(self, everybody: bool = False) -> None:
        for worker in self.workers:
            if everybody or self._thaw.get(worker.pid, float("inf")) < time.monotonic():
                self._thaw.pop(worker.pid, None)
                worker.send_signal(signal.SIGCONT)

    def revive(self) -> None:
        """Starts again a worker that has left with a failure, as an init system would; the coordinator may not."""
        assert self.coordinator.poll() is None, (self.root / "log").read_text()[-4000:]
        for number, worker in enumerate(self.workers):
            if worker.poll() not in {None, 0}:
                self.workers[number] = self._start_worker(number)

    def end(self) -> None:
        self.thaw(everybody=True)
        for process in (*self.workers, self.coordinator):
            process.send_signal(signal.SIGTERM)
        for process in (*self.workers, self.coordinator):
            assert process.wait(20) == 0, f"deaf to SIGTERM: {process.args!r}"

    def abandon(self) -> None:
        for process in (*self.workers, self.coordinator):
            process.kill()
            process.wait()


def _children(pid: int) -> list[int]:
    """Returns the processes that any thread of a process has started."""
    try:
        lists = [path.read_text() for path in Path(f"/proc/{pid}/task").glob("*/children")]
    except (FileNotFoundError, ProcessLookupError):
        return []
    return [int(child) for text in lists for child in text.split()]


def _run(root: Path, workers: int, longest_s: float, seed: int | None) -> Scene:
    root.mkdir()
    rng = random.Random(seed)
    begun = time.monotonic()
    next_harm = begun + 3.0
    with ExitStack() as stack:
        scene = Scene(root, workers, longest_s)
        stack.callback(scene.abandon)
        while len(scene.archived()) < EPISODES:
            now = time.monotonic()
            assert now - begun < LIMIT_S, (scene.faults, scene.events(), (root / "log").read_text()[-4000:])
            if seed is not None and next_harm < now < begun + CHAOS_S:
                scene.harm(rng)
                next_harm = now + rng.uniform(0.3, 1.2)
            scene.thaw()
            scene.revive()
            time.sleep(0.1)
        scene.end()
    return scene


def _digest(scene: Scene) -> str:
    return dataset_digest((str(index), digest) for index, digest in scene.archived().items())


@pytest.mark.slow
@pytest.mark.parametrize("seed", [1, 2])
def test_dataset_of_a_run_full_of_mishaps_equals_that_of_a_calm_one(tmp_path, seed):
    calm = _run(tmp_path / "calm", 1, 0.0, None)
    wild = _run(tmp_path / "wild", 3, 4.0, seed)
    assert sum(wild.faults.values()) > 5
    assert _digest(wild) == _digest(calm)
    files = {path.name for path in (wild.root / "out" / "episodes").iterdir()}
    assert files == {f"ep_{index:06d}.zip" for index in range(1, EPISODES + 1)}
    assert wild.events()["success"] == EPISODES


def test_worker_beside_a_frozen_coordinator_still_heeds_sigterm_within_five_seconds(tmp_path):
    with ExitStack() as stack:
        scene = Scene(tmp_path, 1, 600.0)
        stack.callback(scene.abandon)
        deadline = time.monotonic() + 60
        while scene.leased() < 2:
            assert time.monotonic() < deadline
            scene.revive()
            time.sleep(0.1)
        scene.coordinator.send_signal(signal.SIGSTOP)
        scene.workers[0].send_signal(signal.SIGTERM)
        assert scene.workers[0].wait(5) == 0
