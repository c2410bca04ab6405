"""Restores the state of the test process after a test and reports what the test left changed; starts nothing."""

from __future__ import annotations

import logging
import os
import resource
import signal
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import structlog

LIMITS = (resource.RLIMIT_NOFILE, resource.RLIMIT_FSIZE, resource.RLIMIT_AS, resource.RLIMIT_CORE)
RAISED_BY_COORDINATORS = resource.RLIMIT_NOFILE
"""Limit that a coordinator raises to the hard limit. It is restored like the others, but a test may change
it."""
OF_PYTEST = ("PYTEST_CURRENT_TEST",)
"""Variables that pytest itself changes between the phases of a test."""

_SIGNALS = frozenset(signal.valid_signals() - {signal.SIGALRM})


@dataclass(frozen=True)
class ProcessState:
    """State that the tests of one process share."""

    variables: dict[str, str]
    """Environment variables."""
    folder: Path
    """Working directory."""
    handlers: dict[int, Any]
    """Python handler of each signal; signals that Python does not handle are omitted."""
    levels: tuple[int, int]
    """Level of the root logger of `logging`, and the level up to which `logging` is disabled."""
    limits: dict[int, tuple[int, int]]
    """Soft and hard resource limits."""

    @classmethod
    def now(cls) -> ProcessState:
        """Reads the state of this process."""
        handlers = {number: signal.getsignal(number) for number in _SIGNALS}
        return cls(
            variables={name: value for name, value in os.environ.items() if name not in OF_PYTEST},
            folder=Path.cwd(),
            handlers={number: handler for number, handler in handlers.items() if handler is not None},
            levels=(logging.root.level, logging.root.manager.disable),
            limits={limit: resource.getrlimit(limit) for limit in LIMITS},
        )

    def restore(self) -> list[str]:
        """Restores this state; returns one line for each difference that a test has made."""
        _restore_variables(self.variables)
        leaks = [*_restore_folder(self.folder), *_restore_handlers(self.handlers)]
        if (logging.root.level, logging.root.manager.disable) != self.levels:
            leaks.append(f"logging: {(logging.root.level, logging.root.manager.disable)} instead of {self.levels}")
            logging.root.setLevel(self.levels[0])
            logging.disable(self.levels[1])
        for limit, values in self.limits.items():
            if resource.getrlimit(limit) != values:
                if limit != RAISED_BY_COORDINATORS:
                    leaks.append(f"resource limit {limit}: {resource.getrlimit(limit)} instead of {values}")
                resource.setrlimit(limit, values)
        return leaks


@contextmanager
def unchanged_process() -> Iterator[None]:
    """Restores the state of the process at the end of the `with` block.

    The configuration of structlog and the environment variables are restored without an error, because commands called
    in this process and the import of some libraries (gymnasium) change them.

    Raises:
        AssertionError: the test has changed other state, which is restored as well.
    """
    before = ProcessState.now()
    try:
        yield
    finally:
        structlog.reset_defaults()
        structlog.contextvars.clear_contextvars()
        leaks = before.restore()
    if leaks:
        raise AssertionError("the test did not restore this state, which later tests use: " + "; ".join(leaks))


def _restore_folder(folder: Path) -> Iterator[str]:
    try:
        present = Path.cwd()
    except FileNotFoundError:  # the working directory was deleted
        present = None
    if present != folder:
        os.chdir(folder)
        yield f"working directory: {present} instead of {folder}"


def _restore_variables(variables: dict[str, str]) -> None:
    for name in {*os.environ} - {*variables, *OF_PYTEST}:
        del os.environ[name]
    os.environ.update(variables)


def _restore_handlers(handlers: dict[int, Any]) -> Iterator[str]:
    for number, handler in handlers.items():
        if (present := signal.getsignal(number)) != handler:
            yield f"handler of {signal.Signals(number).name}: {present} instead of {handler}"
            signal.signal(number, handler)


def children_of(pid: int) -> set[int]:
    """Returns the running child processes of a process."""
    found = set()
    for status in Path("/proc").glob("[0-9]*/stat"):
        try:
            fields = status.read_text().rpartition(")")[2].split()
        except OSError:
            continue
        if int(fields[1]) == pid and fields[0] != "Z":
            found.add(int(status.parent.name))
    return found


def is_gone(pid: int) -> bool:
    """Whether the process has ended."""
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] == "Z"
    except OSError:
        return True
