"""Runs the installed `factory` in a separate process with an empty home."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Mapping
from pathlib import Path
from types import MappingProxyType
from typing import Any

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
"""


class FactoryCli:
    """`factory` with a private cache and home; kills the remaining processes at the end."""

    def __init__(self, home: Path, cache: Path, variables: Mapping[str, str] = MappingProxyType({})) -> None:
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

    def __call__(self, *words: object, expect: int = 0, timeout_s: float = 240) -> subprocess.CompletedProcess[str]:
        process = self.start(*words)
        out, err = process.communicate(timeout=timeout_s)
        assert process.returncode == expect, f"factory {words}: exit {process.returncode}\n{out}\n{err}"
        return subprocess.CompletedProcess(process.args, process.returncode, out, err)

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
