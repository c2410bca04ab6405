"""Validation in sandboxed child processes, so that a hostile bundle costs bounded memory and time (DESIGN 9).

Speaks JSON lines with `coordinator.check.validator_child`; a child that dies or hangs is replaced, never trusted again.
"""

from __future__ import annotations

import contextlib
import queue
import subprocess
import sys
import threading
from collections.abc import Iterator
from pathlib import Path
from typing import Annotated

import structlog
from pydantic import Field, ValidationError

from coordinator.summary import EpisodeSummary
from schemas.base import Line, Model
from schemas.closing import Closing
from schemas.errors import InvalidBundle, TransientError
from schemas.job import Job
from schemas.scene import Target

__all__ = ["MAX_FINDINGS", "MAX_FINDING_CHARS", "Limits", "Task", "Validator", "Verdict"]

log = structlog.get_logger(__name__)

MAX_FINDINGS, MAX_FINDING_CHARS = 100, 500
"""Of one verdict; a child that ran a hostile bundle is believed no further."""
_TRIES = 2
_STARTUP_S = 60.0


class Limits(Model):
    """What one child may use."""

    memory_bytes: Annotated[int, Field(ge=256 << 20)] = 1536 << 20
    """Address space (RLIMIT_AS)."""
    cpu_s: Annotated[int, Field(ge=1)] = 120
    """CPU time a bundle; 1000 frames take 4 to 7 s."""
    wall_s: Annotated[float, Field(gt=0)] = 300.0
    """Wall time a bundle."""


class Task(Model):
    """What a child is asked: one line of JSON."""

    path: str
    job: Job
    target: Target | None = None


class Verdict(Model):
    """What a child answers: one line of JSON; exactly one of the two says something."""

    summary: EpisodeSummary | None = None
    findings: Annotated[tuple[Line, ...], Field(max_length=MAX_FINDINGS)] = ()


class Validator(Closing):
    """A pool of validating children; `check` may be called from many threads and waits for a free child.

    Raises:
        TransientError: a child cannot be started.
    """

    def __init__(self, children: int = 1, limits: Limits | None = None) -> None:
        self._limits = limits or Limits()
        self._free: queue.SimpleQueue[_Child] = queue.SimpleQueue()
        self._all = [_Child(self._limits) for _ in range(children)]
        for child in self._all:
            self._free.put(child)

    def check(self, path: Path, job: Job, target: Target | None = None) -> EpisodeSummary:
        """Validates a whole bundle against the job it was asked for.

        Args:
            path: of the bundle, usually a part file.
            job: as leased.
            target: as the compiled scene has it; `None` leaves the comparison out.

        Returns:
            The row of the episode; its SHA-256 and size are those of the file as read.

        Raises:
            InvalidBundle: with every violation; also when the bundle brought two children down.
            TransientError: no child can be started on this machine now.
        """
        task = Task(path=str(path.resolve()), job=job, target=target)
        with self._child() as child:
            for _ in range(_TRIES):
                verdict = child.ask(task)
                if verdict is not None:
                    return _summary_or_raise(verdict)
                log.warning("validator_died", file=str(path), how=child.last_words)
        raise InvalidBundle("validation crashed", [f"{path.name}: {_TRIES} children died of it ({child.last_words})"])

    @contextlib.contextmanager
    def _child(self) -> Iterator[_Child]:
        child = self._free.get()
        try:
            yield child
        finally:
            self._free.put(child)

    def close(self) -> None:
        """Ends all children; one that is at work is killed."""
        for child in self._all:
            child.end()


class _Child:
    """One process, started when first needed and again after every death."""

    def __init__(self, limits: Limits) -> None:
        self._limits = limits
        self._process: subprocess.Popen[str] | None = None
        self._ended = False
        self.last_words = ""

    def ask(self, task: Task) -> Verdict | None:
        """Returns the verdict, or `None` when the child died or had to be killed."""
        process = self._started()
        line = self._exchange(process, task.model_dump_json(), self._limits.wall_s)
        try:
            return Verdict.model_validate_json(line)
        except ValidationError:
            self._kill()
            return None

    def _started(self) -> subprocess.Popen[str]:
        if self._ended:
            raise TransientError("the validator is closed: start the coordinator again")
        if self._process is not None and self._process.poll() is None:
            return self._process
        self._process = _spawn(self._limits)
        if self._exchange(self._process, "", _STARTUP_S) != "ready\n":
            self._kill()
            raise TransientError(f"the validating process does not start ({self.last_words}): is memory left?")
        return self._process

    def _exchange(self, process: subprocess.Popen[str], line: str, limit_s: float) -> str:
        """Sends a line, if any, and returns the answer; empty when the child dies or is too slow."""
        assert process.stdin is not None
        assert process.stdout is not None
        timer = threading.Timer(limit_s, process.kill)
        timer.daemon = True
        timer.start()
        try:
            if line:
                process.stdin.write(f"{line}\n")
                process.stdin.flush()
            return process.stdout.readline()
        except (OSError, ValueError):
            return ""
        finally:
            timer.cancel()

    def _kill(self) -> None:
        process, self._process = self._process, None
        if process is None:
            return
        process.kill()
        code = process.wait()
        _close_pipes(process)
        self.last_words = (
            f"exit status {code}; limits {self._limits.memory_bytes >> 20} MiB, {self._limits.cpu_s} s CPU"
        )

    def end(self) -> None:
        self._ended = True
        self._kill()


def _spawn(limits: Limits) -> subprocess.Popen[str]:
    arguments = [sys.executable, "-m", "coordinator.check.validator_child", limits.model_dump_json()]
    environment = {"PYTHONPATH": ":".join(path for path in sys.path if path), "OPENBLAS_NUM_THREADS": "1"}
    try:
        return subprocess.Popen(
            arguments,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            env=environment,
            text=True,
            encoding="utf-8",
            start_new_session=True,  # an interrupt at the terminal is the coordinator's to handle
        )
    except OSError as error:
        raise TransientError(f"the validating process does not start: {error}") from error


def _close_pipes(process: subprocess.Popen[str]) -> None:
    for pipe in (process.stdin, process.stdout):
        if pipe is not None:
            with contextlib.suppress(OSError):
                pipe.close()


def _summary_or_raise(verdict: Verdict) -> EpisodeSummary:
    if verdict.summary is None:
        raise InvalidBundle("bundle refused", verdict.findings or ("the validator gave no reason",))
    return verdict.summary
