"""Handle of a simulation process: starts it, sends orders, receives reports, kills it. Uses no lease and no network."""

from __future__ import annotations

import contextlib
import os
import queue
import signal
import subprocess
import tempfile
import threading
from collections.abc import Sequence
from dataclasses import dataclass
from typing import IO

import structlog

from schemas.errors import WorldError
from schemas.support.child import child_environment
from schemas.terms import FailReason
from workers.process.messages import SimulationOrder, SimulationReport, read_report, to_line
from workers.process.one_core import one_core

__all__ = ["Death", "Simulation"]

_MAX_OUTPUT_BYTES = 1 << 20
_TAIL_BYTES = 2000
_REAP_S = 2.0

log = structlog.get_logger(__name__)


@dataclass(frozen=True)
class Death:
    """End of a simulation process, which has been reaped."""

    reason: FailReason
    """`crash`, or `hang` if the process was killed because it made no progress."""
    detail: str
    """Explanation with the exit status and the last output."""


class Simulation:
    """Simulation process that can be restarted.

    Args:
        command: command line of the process, which reads orders from stdin and reports to stdout.
        hang_s: time without a report after which a busy process is killed, seconds.
    """

    def __init__(self, command: Sequence[str], hang_s: float) -> None:
        self._command = tuple(command)
        self._hang_s = hang_s
        self._process: subprocess.Popen[bytes] | None = None
        self._reader: threading.Thread | None = None
        self._reports: queue.Queue[SimulationReport | None] = queue.Queue()
        self._stderr: IO[bytes] | None = None
        self._silence_s = 0.0

    @property
    def is_running(self) -> bool:
        """Whether a process was started and its death has not been detected."""
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
        self._stderr = tempfile.TemporaryFile(mode="a+b")  # noqa: SIM115 - closed by kill
        try:
            self._process = subprocess.Popen(
                self._command,
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=self._stderr,
                env=one_core(child_environment(os.environ)),
                start_new_session=True,  # Ctrl-C reaches the supervisor only, which returns its leases
            )
        except OSError as error:
            self._stderr.close()
            raise WorldError(f"cannot start a simulation with `{' '.join(self._command)}`: {error}") from error
        self._reports = queue.Queue()
        self._silence_s = 0.0
        self._reader = threading.Thread(target=_read, args=(self._process.stdout, self._reports), daemon=True)
        self._reader.start()

    def order(self, order: SimulationOrder) -> None:
        """Sends an order; if the process died meanwhile, `receive` returns its death."""
        if self._process is None or self._process.stdin is None:
            raise RuntimeError("order() before start()")
        self._truncate_output()
        self._silence_s = 0.0
        with contextlib.suppress(BrokenPipeError):
            self._process.stdin.write(to_line(order))
            self._process.stdin.flush()

    def receive(self, timeout_s: float) -> SimulationReport | Death | None:
        """Returns the next report, the death of the process, or `None` after `timeout_s` seconds without a report.

        Kills a process that sends no report for more than `hang_s`, and returns its death as a hang.
        """
        try:
            report = self._reports.get(timeout=timeout_s)
        except queue.Empty:
            # sum of the waiting times, not wall time, so that a suspended supervisor does not report a hang
            self._silence_s += timeout_s
            return self._give_up() if self._silence_s > self._hang_s else None
        if report is None:
            return self._reap()
        self._silence_s = 0.0
        return report

    def kill(self) -> None:
        """Kills the process, if one is running."""
        process, self._process = self._process, None
        if process is None:
            return
        with contextlib.suppress(ProcessLookupError):
            os.killpg(process.pid, signal.SIGKILL)
        try:
            process.wait(_REAP_S)
        except subprocess.TimeoutExpired:
            log.warning("simulation_unkillable", pid=process.pid)  # stuck in the kernel, e.g. on a dead disk
        if self._reader is not None:
            self._reader.join(_REAP_S)
        for pipe in (process.stdin, process.stdout, self._stderr):
            if pipe is not None:
                with contextlib.suppress(OSError):
                    pipe.close()

    def _give_up(self) -> Death:
        pid, output = self.pid, self._last_output()
        self.kill()
        detail = f"no progress for {self._silence_s:.1f} s (limit {self._hang_s:g} s), killed" + output
        log.warning("simulation_hung", pid=pid, detail=detail)
        return Death(FailReason.HANG, detail)

    def _reap(self) -> Death:
        process, output = self._process, self._last_output()
        if process is None:
            return Death(FailReason.CRASH, "not started")
        try:
            status = process.wait(_REAP_S)
        except subprocess.TimeoutExpired:
            status = -signal.SIGKILL  # it closed its stdout but still runs; `kill` ends it
        self.kill()
        how = f"killed by {signal.Signals(-status).name}" if status < 0 else f"exit status {status}"
        log.warning("simulation_died", pid=process.pid, detail=how + output)
        return Death(FailReason.CRASH, how + output)

    def _last_output(self) -> str:
        if self._stderr is None:
            return ""
        self._stderr.seek(0, os.SEEK_END)
        self._stderr.seek(max(0, self._stderr.tell() - _TAIL_BYTES))
        lines = self._stderr.read().decode(errors="replace").strip().splitlines()
        return f"; last output: {lines[-1].strip()}" if lines else ""

    def _truncate_output(self) -> None:
        if self._stderr is not None and os.fstat(self._stderr.fileno()).st_size > _MAX_OUTPUT_BYTES:
            os.ftruncate(self._stderr.fileno(), 0)


def _read(stream: IO[bytes], reports: queue.Queue[SimulationReport | None]) -> None:
    with contextlib.suppress(ValueError, OSError):  # `kill` closes the stream
        for line in stream:
            report = read_report(line)
            if report is None:
                log.warning("simulation_output_invalid", line=line[:200].decode(errors="replace"))
            else:
                reports.put(report)
    reports.put(None)
