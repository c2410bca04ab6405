"""Validation in sandboxed child processes, so that a hostile bundle costs bounded memory and time.

Design: docs/design/protocol.md#security.

A child (`coordinator.validation.validator_child`) gets each bundle as an open file and answers with a line of JSON. One
that dies, hangs or says too much is replaced.
"""

from __future__ import annotations

import contextlib
import errno
import os
import queue
import socket
import stat
import struct
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Annotated

import structlog
from pydantic import Field, ValidationError

from coordinator.validation.sandbox import SECCOMP
from schemas.base import Line, Model
from schemas.dataset import EpisodeSummary
from schemas.errors import InvalidBundle, TransientError
from schemas.job import Job
from schemas.scene import Target
from schemas.support.child import import_path, python_module
from schemas.support.closing import Closing
from schemas.support.jsonl_process import JsonlProcess
from schemas.support.log_limit import LogLimit

__all__ = [
    "HEADER",
    "MAX_FINDINGS",
    "MAX_FINDING_CHARS",
    "ValidationTask",
    "Validator",
    "ValidatorLimits",
    "Verdict",
    "sandbox_of",
]

log = structlog.get_logger(__name__)

MAX_FINDINGS, MAX_FINDING_CHARS = 100, 500
"""Of one verdict; a child that ran a hostile bundle is believed no further."""
_TRIES = 2
_LONGEST_PAUSE_S = 60.0
"""Between two log lines about children that died."""
_STARTUP_S = 60.0
_MOST_ANSWER_BYTES = 4 << 20
_GONE = frozenset({errno.ENOENT, errno.ENOTDIR, errno.EISDIR, errno.ELOOP})
HEADER = struct.Struct("!I")
"""Before a task: its length in bytes. The open bundle is sent with it."""


class ValidatorLimits(Model):
    """What one child may use."""

    memory_bytes: Annotated[int, Field(ge=256 << 20)] = 1536 << 20
    """Address space (RLIMIT_AS)."""
    cpu_s: Annotated[int, Field(ge=1)] = 120
    """CPU time a bundle; 1000 frames take 4 to 7 s."""
    wall_s: Annotated[float, Field(gt=0)] = 300.0
    """Wall time a bundle."""


class ValidationTask(Model):
    """What a child is asked about the open bundle that comes with it."""

    job: Job
    target: Target | None = None


class Verdict(Model):
    """What a child answers: one line of JSON; exactly one of the two says something."""

    summary: EpisodeSummary | None = None
    findings: Annotated[tuple[Line, ...], Field(max_length=MAX_FINDINGS)] = ()


class Validator(Closing):
    """A pool of validating children; `check` may be called from many threads and waits for a free child.

    Args:
        children: how many.
        limits: of each.
        clock: monotonic seconds, by which log lines are limited.

    Raises:
        TransientError: a child cannot be started.
    """

    def __init__(
        self, children: int = 1, limits: ValidatorLimits | None = None, clock: Callable[[], float] = time.monotonic
    ) -> None:
        self._limits = limits or ValidatorLimits()
        self._layers: tuple[str, ...] = ()
        self._limit = LogLimit(1.0, _LONGEST_PAUSE_S, clock)
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
            TransientError: no child can be started, or the file not be opened, on this machine now.
        """
        task = ValidationTask(job=job, target=target)
        with self._child() as child:
            for _ in range(_TRIES):
                verdict = self._ask(child, task, path)
                if verdict is not None:
                    return _summary_or_raise(verdict)
                self._limit.write(log.warning, "validator_died", file=str(path), how=child.last_words)
        raise InvalidBundle(
            "validation crashed", [f"{path.name}: {_TRIES} validating processes died ({child.last_words})"]
        )

    def _ask(self, child: _Child, task: ValidationTask, path: Path) -> Verdict | None:
        with _opened(path) as bundle:
            verdict = child.ask(task, bundle)
        if child.layers and not self._layers:
            self._layers = child.layers
            _tell_sandbox(child.layers)
        return verdict

    @property
    def layers(self) -> tuple[str, ...]:
        """What confines its processes, e.g. `rlimits` and `seccomp`; empty before the first bundle."""
        return self._layers

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

    def __init__(self, limits: ValidatorLimits) -> None:
        self._limits = limits
        self._process: JsonlProcess[bytes] | None = None
        self._orders: socket.socket | None = None
        self._ended = False
        self.last_words = ""
        self.layers: tuple[str, ...] = ()
        """What confines it, once it has been started."""

    def ask(self, task: ValidationTask, bundle: int) -> Verdict | None:
        """Returns the verdict, or `None` when the child died or had to be killed."""
        process = self._started()
        line = self._exchange(process, self._limits.wall_s, (task.model_dump_json().encode(), bundle))
        try:
            return Verdict.model_validate_json(line)
        except ValidationError:
            self._kill()
            return None

    def _started(self) -> JsonlProcess[bytes]:
        if self._ended:
            raise TransientError("the validator is closed: start the coordinator again")
        if self._process is not None and self._process.is_running:
            return self._process
        self._kill()
        self._process, self._orders = _spawn(self._limits)
        word, *layers = self._exchange(self._process, _STARTUP_S).decode(errors="replace").split() or [""]
        self.layers = tuple(layers)
        if word != "ready":
            self._kill()
            raise TransientError(f"the validating process does not start ({self.last_words}): check the free memory")
        return self._process

    def _exchange(self, process: JsonlProcess[bytes], limit_s: float, order: tuple[bytes, int] | None = None) -> bytes:
        """Sends a task with its bundle, if any, and returns the answer; empty when the child dies or is too slow."""
        assert self._orders is not None
        end = time.monotonic() + limit_s
        try:
            if order is not None:
                text, bundle = order
                self._orders.settimeout(limit_s)
                socket.send_fds(self._orders, [HEADER.pack(len(text))], [bundle])
                self._orders.sendall(text)
            return process.read(max(0.0, end - time.monotonic())) or b""
        except (OSError, EOFError):
            return b""

    def _kill(self) -> None:
        process, self._process = self._process, None
        if process is None:
            return
        code = process.kill()
        if self._orders is not None:
            self._orders.close()
        self._orders = None
        self.last_words = (
            f"exit status {code}; limits {self._limits.memory_bytes >> 20} MiB, {self._limits.cpu_s} s CPU"
        )

    def end(self) -> None:
        self._ended = True
        self._kill()


def _spawn(limits: ValidatorLimits) -> tuple[JsonlProcess[bytes], socket.socket]:
    """Starts a child; its standard input is the other end of the returned socket."""
    arguments = python_module("coordinator.validation.validator_child", limits.model_dump_json())
    environment = {"PYTHONPATH": import_path(sys.path), "OPENBLAS_NUM_THREADS": "1"}
    ours, theirs = socket.socketpair()
    try:
        process = JsonlProcess(
            arguments,
            environment,
            bytes,
            stdin=theirs.fileno(),
            keeps_stderr=False,
            max_line_bytes=_MOST_ANSWER_BYTES,
        )
    except OSError as error:
        ours.close()
        raise TransientError(f"the validating process does not start: {error}") from error
    finally:
        theirs.close()
    return process, ours


@contextlib.contextmanager
def _opened(path: Path) -> Iterator[int]:
    """Opens a bundle for the child, which cannot open files itself.

    Raises:
        InvalidBundle: there is no regular file of that name.
        TransientError: it cannot be opened now.
    """
    try:
        descriptor = os.open(path, os.O_RDONLY | os.O_CLOEXEC | os.O_NONBLOCK)  # a pipe would be waited for
    except OSError as error:
        if error.errno in _GONE:
            raise InvalidBundle("bundle refused", [f"cannot be read: {error}"]) from error
        raise TransientError(f"{path} cannot be opened: {error.strerror}") from error
    try:
        if not stat.S_ISREG(os.fstat(descriptor).st_mode):
            raise InvalidBundle("bundle refused", ["cannot be read: not a regular file"])
        yield descriptor
    finally:
        os.close(descriptor)


def sandbox_of(judge: object) -> tuple[str, ...]:
    """Returns what confines the processes of a judge; empty before the first bundle, or without processes."""
    return judge.layers if isinstance(judge, Validator) else ()


def _tell_sandbox(layers: Sequence[str]) -> None:
    active = ", ".join(layers)
    if SECCOMP in layers:
        log.info("validator_sandbox", active=active)
    else:
        remedy = "install the extra `sandbox` (pyseccomp) and the system's libseccomp2 to forbid files and network too"
        log.warning("validator_sandbox", active=active, remedy=remedy)


def _summary_or_raise(verdict: Verdict) -> EpisodeSummary:
    if verdict.summary is None:
        raise InvalidBundle("bundle refused", verdict.findings or ("the validator gave no reason",))
    return verdict.summary
