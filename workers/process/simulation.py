"""Handle of a simulation process: starts it, sends orders, receives reports, kills it. Uses no lease and no network."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass

import structlog

from schemas.errors import WorldError
from schemas.support.child import child_environment
from schemas.support.child_process import ChildProcess, Ended
from schemas.terms import FailReason
from workers.process.messages import BuildTask, SimulationOrder, SimulationReport, read_report, to_line
from workers.process.one_core import one_core

log = structlog.get_logger(__name__)


@dataclass(frozen=True)
class ProcessEnd:
    """End of a simulation process, which has been reaped."""

    reason: FailReason
    """`crash`, `hang` if the process was killed because it made no progress, or `released` if a signal from outside
    ended it."""
    detail: str
    """Explanation with the exit status and the last output."""
    is_killed: bool = False
    """Whether SIGKILL ended the process. The kernel sends it if memory is exhausted; a batch system sends it and ends
    the worker too."""


class Simulation:
    """Simulation process that can be restarted.

    Args:
        command: command line of the process, which reads orders from stdin and reports to stdout.
        hang_s: time without a report after which a busy process is killed, seconds.
        start_s: time without a report after which a process that has not yet received an order is killed, seconds.
    """

    def __init__(self, command: Sequence[str], hang_s: float, start_s: float = 60.0) -> None:
        self._command = tuple(command)
        self._process = ChildProcess(_parse, start_s=start_s, silence_s=hang_s)

    @property
    def is_running(self) -> bool:
        """Whether a process was started and its end has not been detected."""
        return self._process.is_started

    @property
    def pid(self) -> int | None:
        """Process id, or `None` if no process is running."""
        return self._process.pid

    @property
    def failed_starts(self) -> int:
        """Number of processes in a row that ended, or hung, before their first report."""
        return self._process.failed_starts

    def start(self) -> None:
        """Starts a new process; its first report is `ready`.

        Raises:
            WorldError: the process cannot be started.
        """
        self.kill()
        try:
            self._process.start(self._command, one_core(child_environment(os.environ), many_scenes=True))
        except OSError as error:
            raise WorldError(f"cannot start a simulation with `{' '.join(self._command)}`: {error}") from error

    def order(self, order: SimulationOrder | BuildTask) -> None:
        """Sends an order; `receive` reports a process that has died meanwhile."""
        if not self.is_running:
            raise RuntimeError("order() before start()")
        self._process.send(to_line(order))

    def receive(self, timeout_s: float) -> SimulationReport | ProcessEnd | None:
        """Returns the next report, the end of the process, or `None` after `timeout_s` seconds without a report.

        Kills a process that sends no report for more than `hang_s`, or `start_s` before its first order, and returns
        its end as a hang.
        """
        if not self.is_running:
            return ProcessEnd(FailReason.CRASH, "not started")
        report = self._process.receive(timeout_s)
        return _end_of(report) if isinstance(report, Ended) else report

    def kill(self) -> None:
        """Kills the process, if one is running."""
        end = self._process.kill()
        if end is not None and not end.is_reaped:
            log.warning("simulation_unkillable", pid=end.pid)


def _end_of(end: Ended) -> ProcessEnd:
    last_output = f"; last output: {end.last_output}" if end.last_output else ""
    if end.is_hung:
        detail = f"no progress for {end.silence_s:.1f} s (limit {end.limit_s:g} s), killed{last_output}"
        log.warning("simulation_hung", pid=end.pid, detail=detail)
        reason = FailReason.HANG
    else:
        detail = end.description + last_output
        log.warning("simulation_died", pid=end.pid, detail=detail)
        reason = FailReason.RELEASED if end.is_from_outside else FailReason.CRASH
    if not end.is_reaped:
        log.warning("simulation_unkillable", pid=end.pid)
    return ProcessEnd(reason, detail, is_killed=end.is_killed and not end.is_hung)


def _parse(line: bytes) -> SimulationReport | None:
    report = read_report(line)
    if report is None:
        log.warning("simulation_output_invalid", line=line[:200].decode(errors="replace"))
    return report
