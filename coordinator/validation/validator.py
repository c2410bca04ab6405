"""Validates bundles in sandboxed child processes, which bounds the memory and time that a hostile bundle uses.

Design: docs/design/protocol.md#security.

A child (`coordinator.validation.validator_child`) receives bundles as open files and replies with a line of JSON.
The pool replaces a child that terminates, hangs or replies with too much data.
"""

from __future__ import annotations

import contextlib
import errno
import os
import queue
import stat
import sys
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from types import MappingProxyType

import structlog
from pydantic import ValidationError

from coordinator.validation.messages import (
    HEADER,
    MAX_TASKS,
    Scope,
    ValidationOrder,
    ValidationTask,
    ValidatorLimits,
    Verdict,
    Verdicts,
)
from coordinator.validation.sandbox import SECCOMP
from schemas.dataset.rows import EpisodeSummary
from schemas.errors import InvalidBundle, TransientError
from schemas.job import Job
from schemas.scene import Target
from schemas.support.child import import_path, python_module
from schemas.support.child_process import ChildProcess, Ended
from schemas.support.closing import Closing
from schemas.support.log_limit import LogLimit

_TRIES = 2
"""Number of children that may die during the validation of a bundle before the bundle is refused."""
# the second child is new, so earlier bundles cannot be the cause; a child that a signal from outside ended does not
# count
_LONGEST_PAUSE_S = 60.0
"""Longest pause between two log lines about terminated children, seconds."""
_STARTUP_S = 60.0
_MOST_ANSWER_BYTES = 4 << 20
_GONE = frozenset({errno.ENOENT, errno.ENOTDIR, errno.EISDIR, errno.ELOOP})

log = structlog.get_logger(__name__)


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
        self._free: queue.LifoQueue[_Child] = queue.LifoQueue()
        self._all = [_Child(self._limits) for _ in range(children)]
        # the child used last is used next, so no more children start than validate at the same time
        for child in self._all:
            self._free.put(child)

    def check(
        self, path: Path, job: Job, candidates: tuple[Target, ...] = (), scope: Scope = Scope.ALL
    ) -> EpisodeSummary:
        """Validates a bundle against its job.

        Args:
            path: path of the bundle, usually a part file.
            job: leased job.
            candidates: targets of the compiled scene that the episode may have; if empty, they are not compared.
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

    def check_all(self, bundles: Sequence[tuple[Path, ValidationTask]]) -> list[EpisodeSummary | InvalidBundle]:
        """Validates several bundles in one order, which costs less than an order for each.

        If the child terminates, or a file cannot be opened, the bundles are validated one after another.

        Args:
            bundles: path, usually of a part file, and task of each bundle.

        Returns:
            The row or the violations of each bundle, in their order.

        Raises:
            TransientError: see `check`.
        """
        results: list[EpisodeSummary | InvalidBundle] = []
        for start in range(0, len(bundles), MAX_TASKS):
            order = bundles[start : start + MAX_TASKS]
            for (path, task), verdict in zip(order, self._verdicts(order), strict=True):
                assert task.job is not None
                try:
                    results.append(self._with_sentence(verdict or self._verdict(task, path), task.job))
                except InvalidBundle as error:
                    results.append(error)
        return results

    def check_package(self, path: Path) -> None:
        """Decodes the package of a scene; raises the errors of `check`."""
        verdict = self._verdict(ValidationTask(), path)
        if verdict.findings:
            raise InvalidBundle("bundle refused", verdict.findings)

    def _verdicts(self, bundles: Sequence[tuple[Path, ValidationTask]]) -> Sequence[Verdict | None]:
        """Returns the results of one order; `None` for bundles that must be validated separately."""
        nothing = [None] * len(bundles)
        if len(bundles) == 1:
            return nothing
        tasks = tuple(task for _, task in bundles)
        try:
            with self._child() as child, contextlib.ExitStack() as opened:
                descriptors = [opened.enter_context(_opened(path)) for path, _ in bundles]
                return self._ask(child, tasks, descriptors) or nothing
        except InvalidBundle:
            return nothing

    def _verdict(self, task: ValidationTask, path: Path) -> Verdict:
        with self._child() as child:
            for _ in range(_TRIES):
                with _opened(path) as bundle:
                    verdicts = self._ask(child, (task,), [bundle])
                if verdicts:
                    return verdicts[0]
                self._limit.write(log.warning, "validator_died", file=str(path), how=child.exit_description)
                if child.was_ended:
                    raise TransientError(
                        f"a signal from outside ended the validating process ({child.exit_description})"
                    )
        raise InvalidBundle(
            "validation crashed", [f"{path.name}: {_TRIES} validating processes died ({child.exit_description})"]
        )

    def _with_sentence(self, verdict: Verdict, job: Job) -> EpisodeSummary:
        """Returns the row of a valid bundle, after checking that a verified instruction fits the scene.

        The children have no scenes, so this process compares the instruction with the scene.
        """
        summary, package = _summary_or_raise(verdict), self._packages.get(job.scene_sha256)
        if verdict.language is not None and package is not None:
            from coordinator.validation.instruction_check import (
                sentence_findings,  # most runs have no verified instructions
            )

            start = (summary.spawn_x_m, summary.spawn_y_m, summary.spawn_yaw_rad)
            aimed = job.model_copy(update={"target_id": summary.target_id})
            found = sentence_findings(aimed, verdict.language, start, package)
            if found:
                raise InvalidBundle("bundle refused", found)
        return summary

    def _ask(
        self, child: _Child, tasks: tuple[ValidationTask, ...], bundles: Sequence[int]
    ) -> tuple[Verdict, ...] | None:
        verdicts = child.ask(ValidationOrder(tasks=tasks), bundles)
        if child.layers and not self._layers:
            self._layers = child.layers
            _log_sandbox(child.layers)
        return verdicts

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
            child.close()


class _Child:
    """Child process, started on first use and again after each termination."""

    def __init__(self, limits: ValidatorLimits) -> None:
        self._limits = limits
        self._process: ChildProcess[bytes] = ChildProcess(
            bytes,
            start_s=_STARTUP_S,
            silence_s=limits.wall_s,
            stderr="discard",
            max_line_bytes=_MOST_ANSWER_BYTES,
        )
        self._is_closed = False
        self.exit_description = ""
        self.was_ended = False
        """Whether a signal from outside, e.g. of a batch system, ended the last process."""
        self.layers: tuple[str, ...] = ()
        """Active sandbox layers; empty before the start."""

    def ask(self, order: ValidationOrder, bundles: Sequence[int]) -> tuple[Verdict, ...] | None:
        """Returns the verdict on each bundle, or `None` if the child terminated or was killed."""
        if not self._process.is_alive:
            self._start()
        text = order.model_dump_json().encode()
        self._process.send(HEADER.pack(len(text)) + text, bundles)
        line = self._receive()
        with contextlib.suppress(ValidationError):
            verdicts = Verdicts.model_validate_json(line).verdicts
            if len(verdicts) == len(bundles):
                return verdicts
        self._kill()
        return None

    def _start(self) -> None:
        """Starts a child and waits until its sandbox is active."""
        if self._is_closed:
            raise TransientError("the validator is closed: start the coordinator again")
        arguments = python_module("coordinator.validation.validator_child", self._limits.model_dump_json())
        environment = {"PYTHONPATH": import_path(sys.path), "OPENBLAS_NUM_THREADS": "1"}
        try:
            self._process.start(arguments, environment)
        except OSError as error:
            raise TransientError(f"the validating process does not start: {error}") from error
        word, *layers = self._receive().decode(errors="replace").split() or [""]
        self.layers = tuple(layers)
        if word != "ready":
            self._kill()
            if self.was_ended:
                raise TransientError(
                    "a signal from outside, such as that of a batch system, ended the validating process"
                )
            raise TransientError(
                f"the validating process does not start ({self.exit_description}): check the free memory"
            )

    def _receive(self) -> bytes:
        """Returns the answer of the child; empty if it dies or is too slow."""
        answer = self._process.wait()
        return self._note_end(answer) if isinstance(answer, Ended) else answer

    def _kill(self) -> None:
        end = self._process.kill()
        if end is not None:
            self._note_end(end)

    def _note_end(self, end: Ended) -> bytes:
        self.was_ended = end.is_from_outside
        self.exit_description = (
            f"exit status {end.status}; limits {self._limits.memory_bytes >> 20} MiB, {self._limits.cpu_s} s CPU"
        )
        return b""

    def close(self) -> None:
        self._is_closed = True
        self._kill()


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
        log.info("validator_sandbox", active=active)
    else:
        remedy = "install the extra `sandbox` (pyseccomp) and the system's libseccomp2 to forbid files and network too"
        log.warning("validator_sandbox", active=active, remedy=remedy)


def _summary_or_raise(verdict: Verdict) -> EpisodeSummary:
    if verdict.summary is None:
        raise InvalidBundle("bundle refused", verdict.findings or ("the validator gave no reason",))
    return verdict.summary
