"""Runs the installed `factory` in separate processes with an empty home.

`start` and `fresh` start a new interpreter, for runs and for processes that are killed. `run` and a call fork a process
that has imported the commands, which saves the seconds that an interpreter needs to import them.
"""

from __future__ import annotations

import json
import os
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
from tests.builders.fork_server import ForkServer

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
control_hz = 30
success_radius_m = 1.4
[robot]
physics_substeps = 8
"""
"""Short drives with half of the usual frames per second, in the usual physics steps."""

IMPORTED = (
    *(f"factory.cli.{entry.module}" for name, entry in VERBS.items() if name != "bench"),  # which sets variables
    *("coordinator.service", "factory.scenes.build", "factory.scenes.compile.compiler", "factory.scenes.importer"),
    *("factory.verify.episode", "av", "trimesh"),
)
"""Modules that the commands import."""
_HANGS_S = 800.0
"""Time after which a command counts as hung, seconds; it is killed."""


def start_server() -> ForkServer:
    """Starts the process that the commands are forked from; the caller closes it."""
    return ForkServer(("factory.__main__", *IMPORTED), os.environ)


class FactoryCli:
    """`factory` with a private cache and home; kills the remaining processes at the end."""

    def __init__(
        self, server: ForkServer, home: Path, cache: Path, variables: Mapping[str, str] = MappingProxyType({})
    ) -> None:
        self._server = server
        self._environment = {**os.environ, "HOME": str(home), "MINIVLA_CACHE": str(cache), **variables}
        self._environment.pop("XDG_CACHE_HOME", None)
        self._started: list[subprocess.Popen[str]] = []

    def start(self, *words: object) -> subprocess.Popen[str]:
        process = subprocess.Popen(
            [sys.executable, "-m", "factory", *map(str, words)],
            env=self._environment,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
            start_new_session=True,
        )
        self._started.append(process)
        return process

    def fresh(self, *words: object) -> None:
        """Runs a command in a new interpreter; fails unless it succeeds."""
        process = self.start(*words)
        try:
            _, err = process.communicate(timeout=_HANGS_S)
        finally:
            if process.poll() is None:
                kill_group(process)
        assert process.returncode == 0, f"factory {words}: exit {process.returncode}\n{err}"

    def run(self, *words: object) -> subprocess.CompletedProcess[str]:
        """Runs a command in a forked process, whatever its exit status."""
        args = [*map(str, words)]
        with tempfile.TemporaryDirectory() as folder:
            out, err = Path(folder, "out"), Path(folder, "err")
            child = self._server.start("factory.__main__", args, self._environment, out, err)
            try:
                status = child.wait(_HANGS_S)
            finally:
                child.kill()
            return subprocess.CompletedProcess(args, status, out.read_text(), err.read_text())

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
            for stream in (process.stdout, process.stderr):
                if stream is not None:
                    stream.close()


def kill_group(process: subprocess.Popen[str], number: int = signal.SIGKILL) -> None:
    os.killpg(process.pid, number)
    process.wait(30)


def wait_for(condition: Callable[[], bool], timeout_s: float = 120) -> None:
    deadline = time.monotonic() + timeout_s
    while not condition():
        assert time.monotonic() < deadline, "waited too long"
        time.sleep(0.05)


def episodes_in(root: Path) -> list[str]:
    return sorted(path.name for path in (root / "episodes").glob("*.zip"))
