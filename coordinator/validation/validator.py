"""Validates bundles in sandboxed child processes, which bounds the memory and time that a hostile bundle uses.

Design: docs/design/protocol.md#security.

A child (`coordinator.validation.validator_child`) receives each bundle as an open file and replies with a line of JSON.
The pool replaces a child that terminates, hangs or replies with too much data.
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
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from types import MappingProxyType
from typing import Annotated, Any

from pydantic import Field, ValidationError

from coordinator.validation.sandbox import SECCOMP
from coordinator.validation.scope import Scope
from schemas.base import Line, Model
from schemas.dataset.rows import EpisodeSummary
from schemas.errors import InvalidBundle, TransientError
from schemas.job import Job
from schemas.language.instruction import Instruction
from schemas.scene import Target
from schemas.support.child import import_path, python_module
from schemas.support.closing import Closing
from schemas.support.jsonl_process import ENDED_FROM_OUTSIDE, JsonlProcess
from schemas.support.log_limit import LogLimit

MAX_FINDINGS, MAX_FINDING_CHARS = 100, 500
"""Maximum number and length of the findings of a verdict; the output of a child with a hostile bundle is untrusted."""
_TRIES = 2
_LONGEST_PAUSE_S = 60.0
"""Longest pause between two log lines about terminated children, seconds."""
_STARTUP_S = 60.0
_MOST_ANSWER_BYTES = 4 << 20
_GONE = frozenset({errno.ENOENT, errno.ENOTDIR, errno.EISDIR, errno.ELOOP})
HEADER = struct.Struct("!I")
"""Header of a task: its length, bytes. The descriptor of the open bundle is sent with the header."""


class ValidatorLimits(Model):
    """Resource limits of a child."""

    memory_bytes: Annotated[int, Field(ge=256 << 20)] = 1536 << 20
    """Limit of the address space (RLIMIT_AS), bytes."""
    cpu_s: Annotated[int, Field(ge=1)] = 120
    """CPU time per bundle, seconds; 1000 frames take 4 to 7 s."""
    wall_s: Annotated[float, Field(gt=0)] = 300.0
    """Wall time per bundle, seconds."""


class ValidationTask(Model):
    """Task of a child for the bundle whose descriptor is sent with it."""

    job: Job | None = None
    """Leased job; `None` if the bundle is the package of a scene."""
    candidates: tuple[Target, ...] = ()
    """Targets of the compiled scene that the episode may have; none skips the comparison."""
    scope: Scope = Scope.ALL
    """Part of the bundle that is read."""


class Verdict(Model):
    """Reply of a child: one line of JSON with either a summary or findings."""

    summary: EpisodeSummary | None = None
    """Row of the episode; `None` if the bundle is invalid."""
    language: Instruction | None = None
    """Verified instruction of the episode, which is then compared with the scene; `None` for a template."""
    findings: Annotated[tuple[Line, ...], Field(max_length=MAX_FINDINGS)] = ()
    """Violations."""


class Validator(Closing):
    """Thread-safe pool of validating child processes; `check` waits for a free child.

    Args:
        children: number of children.
        limits: resource limits of each child.
        clock: monotonic clock for the rate limit of log lines, seconds.
        packages: packages of scenes by SHA-256; instructions in other scenes are not compared with the scene.

    Raises:
        TransientError: a child cannot be started.
    """

    def __init__(
        self,
        children: int = 1,
        limits: ValidatorLimits | None = None,
        clock: Callable[[], float] = time.monotonic,
        packages: Mapping[str, Path] = MappingProxyType({}),
    ) -> None:
        self._packages = packages
        self._limits = limits or ValidatorLimits()
        self._layers: tuple[str, ...] = ()
        self._limit = LogLimit(1.0, _LONGEST_PAUSE_S, clock)
        self._free: queue.SimpleQueue[_Child] = queue.SimpleQueue()
        self._all = [_Child(self._limits) for _ in range(children)]
        for child in self._all:
            self._free.put(child)

    def check(
        self, path: Path, job: Job, candidates: tuple[Target, ...] = (), scope: Scope = Scope.ALL
    ) -> EpisodeSummary:
        """Validates a bundle against its job.

        Args:
            path: path of the bundle, usually a part file.
            job: leased job.
            candidates: targets of the compiled scene that the episode may have; none skips the comparison.
            scope: part of the bundle that is read.

        Returns:
            The row of the episode, with SHA-256 and size of the file.

        Raises:
            InvalidBundle: the bundle has violations, or two children terminated while they validated it.
            TransientError: no child can be started on this machine now, a signal from outside ended it, or the file
                cannot be opened now.
        """
        verdict = self._verdict(ValidationTask(job=job, candidates=candidates, scope=scope), path)
        return self._with_sentence(verdict, job)

    def check_package(self, path: Path) -> None:
        """Decodes the package of a scene; raises the errors of `check`."""
        verdict = self._verdict(ValidationTask(), path)
        if verdict.findings:
            raise InvalidBundle("bundle refused", verdict.findings)

    def _verdict(self, task: ValidationTask, path: Path) -> Verdict:
        with self._child() as child:
            for _ in range(_TRIES):
                verdict = self._ask(child, task, path)
                if verdict is not None:
                    return verdict
                self._limit.write(_log().warning, "validator_died", file=str(path), how=child.last_words)
                if child.was_ended:
                    raise TransientError(f"a signal from outside ended the validating process ({child.last_words})")
        raise InvalidBundle(
            "validation crashed", [f"{path.name}: {_TRIES} validating processes died ({child.last_words})"]
        )

    def _with_sentence(self, verdict: Verdict, job: Job) -> EpisodeSummary:
        """Returns the row of a valid bundle; its instruction fits the scene, if it is a verified one.

        The children have no scenes, so this process compares the instruction with the scene.
        """
        summary, package = _summary_or_raise(verdict), self._packages.get(job.scene_sha256)
        if verdict.language is not None and package is not None:
            from coordinator.validation.language import sentence_findings  # children start faster without it

            start = (summary.spawn_x_m, summary.spawn_y_m, summary.spawn_yaw_rad)
            aimed = job.model_copy(update={"target_id": summary.target_id})
            found = sentence_findings(aimed, verdict.language, start, package)
            if found:
                raise InvalidBundle("bundle refused", found)
        return summary

    def _ask(self, child: _Child, task: ValidationTask, path: Path) -> Verdict | None:
        with _opened(path) as bundle:
            verdict = child.ask(task, bundle)
        if child.layers and not self._layers:
            self._layers = child.layers
            _log_sandbox(child.layers)
        return verdict

    @property
    def layers(self) -> tuple[str, ...]:
        """Active sandbox layers of the children, e.g. `rlimits` and `seccomp`; empty before the first bundle."""
        return self._layers

    @contextlib.contextmanager
    def _child(self) -> Iterator[_Child]:
        child = self._free.get()
        try:
            yield child
        finally:
            self._free.put(child)

    def close(self) -> None:
        """Kills all children, including busy ones."""
        for child in self._all:
            child.end()


class _Child:
    """Child process, started on first use and again after each termination."""

    def __init__(self, limits: ValidatorLimits) -> None:
        self._limits = limits
        self._process: JsonlProcess[bytes] | None = None
        self._orders: socket.socket | None = None
        self._ended = False
        self.last_words = ""
        self.was_ended = False
        """Whether a signal from outside, e.g. of a batch system, ended the last process."""
        self.layers: tuple[str, ...] = ()
        """Active sandbox layers; empty before the start."""

    def ask(self, task: ValidationTask, bundle: int) -> Verdict | None:
        """Returns the verdict, or `None` if the child terminated or was killed."""
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
        self.was_ended = code in ENDED_FROM_OUTSIDE
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
        InvalidBundle: the path is not a regular file.
        TransientError: the file cannot be opened now.
    """
    try:
        descriptor = os.open(path, os.O_RDONLY | os.O_CLOEXEC | os.O_NONBLOCK)  # opening a pipe would block
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


def sandbox_of(validator: object) -> tuple[str, ...]:
    """Returns the active sandbox layers of a validator; empty before the first bundle, or without child processes."""
    return validator.layers if isinstance(validator, Validator) else ()


def _log_sandbox(layers: Sequence[str]) -> None:
    active = ", ".join(layers)
    if SECCOMP in layers:
        _log().info("validator_sandbox", active=active)
    else:
        remedy = "install the extra `sandbox` (pyseccomp) and the system's libseccomp2 to forbid files and network too"
        _log().warning("validator_sandbox", active=active, remedy=remedy)


def _log() -> Any:
    import structlog  # not at the start of each child, which it would slow down

    return structlog.get_logger(__name__)


def _summary_or_raise(verdict: Verdict) -> EpisodeSummary:
    if verdict.summary is None:
        raise InvalidBundle("bundle refused", verdict.findings or ("the validator gave no reason",))
    return verdict.summary
