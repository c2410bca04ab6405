"""Handle of a simulation process: starts it, sends orders, receives reports, kills it. Uses no lease and no network."""

from __future__ import annotations

import os
import signal
from collections.abc import Sequence
from dataclasses import dataclass

import structlog

from schemas.errors import WorldError
from schemas.support.child import child_environment
from schemas.support.jsonl_process import ENDED_FROM_OUTSIDE, JsonlProcess, describe_exit
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
        self._hang_s, self._start_s = hang_s, start_s
        self._limit_s = start_s
        self._process: JsonlProcess[SimulationReport] | None = None
        self._silence_s = 0.0

    @property
    def is_running(self) -> bool:
        """Whether a process was started and its end has not been detected."""
        return self._process is not None

    @property
    def pid(self) -> int | None:
        """Process id, or `None` if no process is running."""
        return self._process.pid if self._process is not None else None

    def start(self) -> None:
        """Starts a new process; its first report is `ready`.

        Raises:
            WorldError: the process cannot be started.
        """
        self.kill()
        try:
            self._process = JsonlProcess(
                self._command, one_core(child_environment(os.environ), many_scenes=True), _parse
            )
        except OSError as error:
            raise WorldError(f"cannot start a simulation with `{' '.join(self._command)}`: {error}") from error
        self._silence_s, self._limit_s = 0.0, self._start_s

    def order(self, order: SimulationOrder | BuildTask) -> None:
        """Sends an order; `receive` reports a process that has died meanwhile."""
        if self._process is None:
            raise RuntimeError("order() before start()")
        self._silence_s, self._limit_s = 0.0, self._hang_s
        self._process.send(to_line(order))

    def receive(self, timeout_s: float) -> SimulationReport | ProcessEnd | None:
        """Returns the next report, the end of the process, or `None` after `timeout_s` seconds without a report.

        Kills a process that sends no report for more than `hang_s`, or `start_s` before its first order, and returns
        its end as a hang.
        """
        if self._process is None:
            return ProcessEnd(FailReason.CRASH, "not started")
        try:
            report = self._process.read(timeout_s)
        except EOFError:
            return self._reap(self._process)
        if report is None:
            # waiting times are added instead of wall time, so a suspended supervisor does not report a hang
            self._silence_s += timeout_s
            return self._give_up(self._process) if self._silence_s > self._limit_s else None
        self._silence_s = 0.0
        return report

    def kill(self) -> None:
        """Kills the process, if one is running."""
        process, self._process = self._process, None
        if process is not None and process.kill() is None:
            log.warning("simulation_unkillable", pid=process.pid)

    def _give_up(self, process: JsonlProcess[SimulationReport]) -> ProcessEnd:
        detail = f"no progress for {self._silence_s:.1f} s (limit {self._limit_s:g} s), killed" + _last_output(process)
        self.kill()
        log.warning("simulation_hung", pid=process.pid, detail=detail)
        return ProcessEnd(FailReason.HANG, detail)

    def _reap(self, process: JsonlProcess[SimulationReport]) -> ProcessEnd:
        status = process.wait()
        detail = describe_exit(status) + _last_output(process)
        self.kill()
        log.warning("simulation_died", pid=process.pid, detail=detail)
        reason = FailReason.RELEASED if status in ENDED_FROM_OUTSIDE else FailReason.CRASH
        return ProcessEnd(reason, detail, is_killed=status == -signal.SIGKILL)


def _last_output(process: JsonlProcess[SimulationReport]) -> str:
    line = process.last_stderr_line()
    return f"; last output: {line}" if line else ""


def _parse(line: bytes) -> SimulationReport | None:
    report = read_report(line)
    if report is None:
        log.warning("simulation_output_invalid", line=line[:200].decode(errors="replace"))
    return report
