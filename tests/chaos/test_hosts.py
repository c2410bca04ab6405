"""Tests runs on hosts in separate network namespaces: a host is disconnected for a time, or has a slow, lossy link."""

from __future__ import annotations

import sqlite3
import subprocess
import time
from collections.abc import Callable, Sequence
from contextlib import ExitStack, closing
from pathlib import Path

import pytest

from schemas.support.child import python_module
from tests.chaos.hosts import Hosts, why_not

EPISODES = 6
LEASE_S = 2.0
REASON = why_not()
pytestmark = [pytest.mark.slow, pytest.mark.skipif(bool(REASON), reason=REASON)]


class Site:
    """A coordinator on host 0, gateways on the next hosts, and a worker on each remaining host."""

    def __init__(self, root: Path, hosts: Hosts, stack: ExitStack, gateways: int = 0) -> None:
        self.root, self.log = root, root / "log"
        endpoint = f"tcp/{hosts.addresses[0]}:7447"
        hub = ("tests.builders.room_coordinator", root, EPISODES, endpoint, LEASE_S)
        self.processes = [self._start(hosts.inside(0, *hub))]
        stack.callback(self._kill)
        endpoints = []
        for number in range(1, gateways + 1):
            endpoints.append(f"tcp/{hosts.addresses[number]}:7447")
            gateway = ("tests.builders.room_gateway", root / f"gw{number}", f"gw{number}", endpoint, endpoints[-1])
            self.processes.append(self._start(hosts.inside(number, *gateway)))
        simulation = python_module("tests.builders.small_simulation", "6.0")
        for number in range(gateways + 1, len(hosts.addresses)):
            worker = ("tests.builders.worker", ",".join(endpoints) or endpoint, root / f"host-{number}", 1, *simulation)
            self.processes.append(self._start(hosts.inside(number, *worker)))

    def ask(self, sql: str) -> int:
        path = self.root / "out" / "ledger.db"
        if not path.exists():
            return 0
        with closing(sqlite3.connect(f"file:{path}?mode=ro", uri=True, timeout=30)) as ledger:
            try:
                return int(ledger.execute(sql).fetchone()[0])
            except sqlite3.OperationalError:
                return 0

    def wait(self, condition: Callable[[], bool], within_s: float = 90) -> None:
        deadline = time.monotonic() + within_s
        while not condition():
            assert time.monotonic() < deadline, self.log.read_text()[-4000:]
            time.sleep(0.1)

    def archived(self) -> int:
        return self.ask("select count(*) from episodes")

    def files_at_gateways(self) -> list[str]:
        return sorted(path.name for path in self.root.glob("gw*/episodes/*"))

    def _start(self, command: Sequence[str]) -> subprocess.Popen[bytes]:
        with self.log.open("ab") as log:
            return subprocess.Popen(command, stdout=log, stderr=log)

    def _kill(self) -> None:
        for process in self.processes:
            process.kill()
            process.wait()


def test_a_disconnected_host_loses_its_jobs_and_reconnects(tmp_path):
    with ExitStack() as stack:
        hosts = stack.enter_context(Hosts(3))
        site = Site(tmp_path, hosts, stack)
        site.wait(lambda: site.ask("select count(distinct sid) from jobs where state = 'leased'") == 2)
        hosts.cut(1)
        site.wait(lambda: site.ask("select count(*) from attempts where outcome = 'expired'") >= 1)
        hosts.heal(1)
        site.wait(lambda: site.archived() == EPISODES)
        assert site.ask("select count(*) from attempts where outcome = 'success'") == EPISODES
        files = sorted(path.name for path in (tmp_path / "out" / "episodes").iterdir())
        assert files == [f"ep_{index:06d}.zip" for index in range(1, EPISODES + 1)]
        assert all(process.poll() in {None, 0} for process in site.processes)


def test_a_host_behind_a_slow_lossy_link_delivers_its_episodes(tmp_path):
    with ExitStack() as stack:
        hosts = stack.enter_context(Hosts(2))
        reason = hosts.degrade(1, "16mbit", "30ms")
        if reason:
            pytest.skip(reason)
        site = Site(tmp_path, hosts, stack)
        site.wait(lambda: site.archived() == EPISODES, 180)
        assert site.ask("select count(*) from attempts where outcome = 'success'") == EPISODES


def test_workers_leave_a_disconnected_gateway_and_its_episodes_are_kept(tmp_path):
    with ExitStack() as stack:
        hosts = stack.enter_context(Hosts(4))
        site = Site(tmp_path, hosts, stack, gateways=2)
        kept = "select count(*) from keepers where gateway = "
        site.wait(lambda: site.archived() >= 1)
        busy = 1 if site.ask(f"{kept}'gw1'") else 2
        hosts.cut(busy)
        before = site.ask(f"{kept}'gw{busy}'")
        site.wait(lambda: site.archived() >= min(EPISODES, before + 2))  # the other gateway delivers them
        hosts.heal(busy)
        site.wait(lambda: site.archived() == EPISODES)
        assert site.ask("select count(*) from attempts where outcome = 'success'") == EPISODES
        assert site.ask("select count(*) from keepers") == EPISODES
        assert not list((tmp_path / "out" / "episodes").iterdir())
        # when the coordinator answers again, the gateway removes a file that it could not report in time
        site.wait(lambda: site.files_at_gateways() == [f"ep_{index:06d}.zip" for index in range(1, EPISODES + 1)])
        assert all(process.poll() in {None, 0} for process in site.processes)
