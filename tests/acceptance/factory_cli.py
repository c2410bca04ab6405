"""Runs the installed `factory` in separate processes with an empty home.

`fresh` starts a new interpreter; it generates the reference dataset. `start`, `run` and calling the object fork a
process that has imported the commands already, which saves seconds.
"""

from __future__ import annotations

import json
import os
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Mapping
from pathlib import Path
from types import MappingProxyType
from typing import Any

from factory.cli.main import VERBS
from tests.builders.fork_server import Child, ForkServer
from tests.test_layering import PACKAGES, ROOT, imports_of

TINY_PLAN = """
name = "tiny"
balance = "categories"
[tiers]
near = 1.0
[splits]
train_id = 0.8
test_ood_obj = 0.2
[[scenes]]
name = "hospital"
episodes = 3
[[scenes]]
name = "warehouse_multiple_shelves"
episodes = 2
[task]
control_hz = 15
success_radius_m = 1.4
[robot]
physics_substeps = 16
max_braking_mps2 = 4.0
"""
"""Plan of short drives with a quarter of the usual frames per second; the physics step has its usual length. The robot
brakes gently, because a robot that stops at once rolls back: in such a long control period, it would roll back further
than validation accepts."""


def _work_of_commands() -> set[str]:
    """Returns the modules of the product that commands import when they are executed."""
    sources = (ROOT / "factory" / "cli").rglob("*.py")
    names = {name for path in sources for name in imports_of(path)}
    return {name for name in names if name.startswith(PACKAGES) and not name.startswith("factory.cli")}


IMPORTED = (
    *(f"factory.cli.{name}" for name in VERBS),
    *sorted(_work_of_commands()),
    *("coordinator.service", "factory.scenes.build", "factory.scenes.compile.compiler", "factory.scenes.importer"),
    *("factory.verify.episode", "factory.report", "av", "pandas", "scipy.stats", "trimesh"),  # pyarrow imports pandas
    *("coordinator.validation.validator_child", "factory.eval.process.child", "factory.runs.build_process"),
    "factory.eval.remote.eval_worker",
    *("factory.web.figures.process", "workers.render.process_child", "workers.sim.simulate", "moderngl"),
    "tests.builders.room_coordinator",
)
"""Modules that the commands and their child processes import, and the coordinator of the kill tests."""
IMPORTED_BY_TESTS = (
    *("tests.builders.room_gateway", "tests.builders.small_simulation", "tests.builders.worker"),
    *("tests.chaos.host_process", "tests.fuzz.child"),
)
"""Modules that tests start directly as processes."""
_HANGS_S = 800.0
"""Time after which a command counts as hung, seconds; it is killed."""


def start_server() -> ForkServer:
    """Starts the fork server for the commands; the caller closes it."""
    return ForkServer(("factory.__main__", *IMPORTED), os.environ, forks_children=True)


class Started:
    """A command in a forked process, with the part of the interface of `subprocess.Popen` that the tests need."""

    def __init__(self, child: Child, out: Path, err: Path) -> None:
        self._child, self._out, self._err = child, out, err
        self.folder = out.parent
        self.pid, self.poll, self.wait = child.pid, child.poll, child.wait
        self.send_signal, self.kill = child.send_signal, child.kill

    @property
    def returncode(self) -> int | None:
        return self._child.poll()

    def terminate(self) -> None:
        self.send_signal(signal.SIGTERM)

    def communicate(self, timeout: float | None = None) -> tuple[str, str]:
        """Waits for the end of the command; returns the text of its stdout and stderr."""
        self.wait(timeout)
        return self._out.read_text(), self._err.read_text()


class FactoryCli:
    """`factory` with a private cache and home; kills the remaining processes at the end."""

    def __init__(
        self, server: ForkServer, home: Path, cache: Path, variables: Mapping[str, str] = MappingProxyType({})
    ) -> None:
        self._server = server
        self._environment = {**os.environ, "HOME": str(home), "MINIVLA_CACHE": str(cache), **variables}
        self._environment.pop("XDG_CACHE_HOME", None)
        self._started: list[Started] = []

    def start(self, *words: object) -> Started:
        """Starts a command in a forked process with its own session."""
        self._started.append(self._fork(Path(tempfile.mkdtemp()), words))
        return self._started[-1]

    def _fork(self, folder: Path, words: tuple[object, ...]) -> Started:
        out, err = folder / "out", folder / "err"
        for file in (out, err):
            file.touch(0o600)  # a test may read these files before the process opens them
        child = self._server.start("factory.__main__", [*map(str, words)], self._environment, out, err)
        return Started(child, out, err)

    def fresh(self, *words: object) -> None:
        """Runs a command in a new interpreter; fails unless it succeeds."""
        done = subprocess.run(
            [sys.executable, "-m", "factory", *map(str, words)],
            env=self._environment,
            stdin=subprocess.DEVNULL,
            capture_output=True,
            text=True,
            timeout=_HANGS_S,
        )
        assert done.returncode == 0, f"factory {words}: exit {done.returncode}\n{done.stderr}"

    def run(self, *words: object) -> subprocess.CompletedProcess[str]:
        """Runs a command in a forked process; accepts any exit status."""
        with tempfile.TemporaryDirectory() as folder:
            started = self._fork(Path(folder), words)
            try:
                out, err = started.communicate(_HANGS_S)
            finally:
                started.kill()
        return subprocess.CompletedProcess([*map(str, words)], started.wait(), out, err)

    def __call__(self, *words: object, expect: int = 0) -> subprocess.CompletedProcess[str]:
        done = self.run(*words)
        assert done.returncode == expect, f"factory {words}: exit {done.returncode}\n{done.stdout}\n{done.stderr}"
        return done

    def json(self, *words: object, expect: int = 0) -> Any:
        return json.loads(self(*words, "--json", expect=expect).stdout)

    def end(self) -> None:
        for process in self._started:
            if process.poll() is None:
                kill_group(process)
            shutil.rmtree(process.folder)


def kill_group(process: Started, number: int = signal.SIGKILL) -> None:
    os.killpg(process.pid, number)
    process.wait(30)


def wait_for(condition: Callable[[], bool], timeout_s: float = 120) -> None:
    deadline = time.monotonic() + timeout_s
    while not condition():
        assert time.monotonic() < deadline, "timed out waiting"
        time.sleep(0.05)


def episodes_in(root: Path) -> list[str]:
    return sorted(path.name for path in (root / "episodes").glob("*.zip"))
