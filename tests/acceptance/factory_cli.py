"""Runs `factory` for tests: the installed command as a process, or its entry point in the process of the test."""

from __future__ import annotations

import json
import os
import shutil
import signal
import subprocess
import sys
import sysconfig
import tempfile
import time
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from types import MappingProxyType
from typing import Any

import pytest
from click.testing import CliRunner

from factory.cli.main import main

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


FACTORY = Path(sysconfig.get_path("scripts")) / "factory"
"""The installed command."""
_HANGS_S = 800.0
"""Time after which a command counts as hung, seconds; it is killed."""


class Started:
    """A started command whose output is in files, so that it never waits for a test that reads its output."""

    def __init__(self, command: Sequence[str | Path], environment: Mapping[str, str]) -> None:
        self.folder = Path(tempfile.mkdtemp())
        self._out, self._err = self.folder / "out", self.folder / "err"
        with self._out.open("wb") as out, self._err.open("wb") as err:
            self._process = subprocess.Popen(
                command, env=environment, stdin=subprocess.DEVNULL, stdout=out, stderr=err, start_new_session=True
            )
        self.pid, self.poll, self.wait = self._process.pid, self._process.poll, self._process.wait
        self.send_signal, self.kill = self._process.send_signal, self._process.kill

    @property
    def returncode(self) -> int | None:
        return self.poll()

    def terminate(self) -> None:
        self.send_signal(signal.SIGTERM)

    def communicate(self, timeout: float | None = None) -> tuple[str, str]:
        """Waits for the end of the command; returns the text of its stdout and stderr."""
        self.wait(timeout)
        return self._out.read_text(), self._err.read_text()


class _Caller(ABC):
    """Runs commands and checks their exit status."""

    @abstractmethod
    def run(self, *words: object) -> subprocess.CompletedProcess[str]:
        """Runs a command; accepts any exit status."""

    def __call__(self, *words: object, expect: int = 0) -> subprocess.CompletedProcess[str]:
        done = self.run(*words)
        assert done.returncode == expect, f"factory {words}: exit {done.returncode}\n{done.stdout}\n{done.stderr}"
        return done

    def json(self, *words: object, expect: int = 0) -> Any:
        return json.loads(self(*words, "--json", expect=expect).stdout)


class Command(_Caller):
    """`factory` in the process of the test, for commands that only parse, read or print.

    A new interpreter imports for seconds before it prints an error.
    """

    def __init__(self, cache: Path, variables: Mapping[str, str] = MappingProxyType({})) -> None:
        self._variables = {"MINIVLA_CACHE": str(cache), **variables}

    def run(self, *words: object) -> subprocess.CompletedProcess[str]:
        """Runs a command; accepts any exit status."""
        arguments = [*map(str, words)]
        with pytest.MonkeyPatch.context() as patch, CliRunner().isolation(env=self._variables) as (out, err, _):
            patch.setattr(sys, "argv", ["factory", *arguments])
            with pytest.raises(SystemExit) as left:
                main()
            sys.stdout.flush()
            sys.stderr.flush()
            return subprocess.CompletedProcess(
                arguments, left.value.code, out.getvalue().decode(), err.getvalue().decode()
            )


class FactoryCli(_Caller):
    """`factory` as a process with a private cache and home; kills the remaining processes at the end."""

    def __init__(self, home: Path, cache: Path, variables: Mapping[str, str] = MappingProxyType({})) -> None:
        self._environment = {**os.environ, "HOME": str(home), "MINIVLA_CACHE": str(cache), **variables}
        self._environment.pop("XDG_CACHE_HOME", None)
        self._started: list[Started] = []

    def start(self, *words: object) -> Started:
        """Starts a command in its own session."""
        self._started.append(Started([FACTORY, *map(str, words)], self._environment))
        return self._started[-1]

    def run(self, *words: object) -> subprocess.CompletedProcess[str]:
        """Runs a command; accepts any exit status."""
        return subprocess.run(
            [FACTORY, *map(str, words)],
            env=self._environment,
            stdin=subprocess.DEVNULL,
            capture_output=True,
            text=True,
            timeout=_HANGS_S,
            start_new_session=True,
        )

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
