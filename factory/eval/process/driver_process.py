"""Manages one driver process: sends orders, receives reports, and kills the process when its policy hangs.

Does not select episodes and does not store results.
"""

from __future__ import annotations

import contextlib
import os
import queue
import signal
import subprocess
import tempfile
import threading
import time
from typing import IO, NamedTuple

from factory.eval.driving.policy import PolicyFault
from factory.eval.models.messages import EvalOrder, EvalReport, EvalReportKind, Setup, read_report, to_line
from factory.eval.policies import renders_apart
from factory.eval.process.shared_status import Activity, DriverStatus, SharedStatus
from schemas.support.child import SAFE_PATH, child_environment, python_module
from workers.process.one_core import one_core

__all__ = ["CHILD", "DriverEnded", "DriverProcess"]

CHILD = python_module("factory.eval.process.child")
_SIMULATION_S = 120.0
_GRACE_S = 5.0
"""Additional time for a policy that enforces its own time limit, seconds."""
_TAIL_BYTES = 4000
_REAP_S = 3.0


class DriverEnded(NamedTuple):
    """End of a driver process, which has been reaped."""

    fault: PolicyFault | None
    """Kind of the policy failure; `None` if no policy call was in progress."""
    detail: str
    state: DriverStatus
    """Last shared status of the process."""


class DriverProcess:
    """Driver process, restarted when needed."""

    def __init__(self, setup: Setup) -> None:
        self.setup = setup
        """Setup sent to the process."""
        self._renders_apart = False
        self._process: subprocess.Popen[bytes] | None = None
        self._reports: queue.Queue[EvalReport | None] = queue.Queue()
        self._sheet: SharedStatus | None = None
        self._stderr: IO[bytes] | None = None
        self.current_order: EvalOrder | None = None
        """Order in progress; `None` when idle."""
        self.made: dict[str, str] = {}
        """Policy name -> description of the information it uses, for policies created in this process."""
        self.renderer = ""
        """Description of the renderer; empty until the process reports it."""

    @property
    def pid(self) -> int | None:
        """Process id; `None` without a running process."""
        return self._process.pid if self._process is not None else None

    @property
    def steps(self) -> int:
        """Number of steps of the current episode."""
        return self._sheet.read().steps if self._sheet is not None else 0

    def give(self, order: EvalOrder) -> None:
        """Sends an order; starts the process if it is not running. `hear` reports a death of the process.

        Restarts a process that renders by itself if the libraries of the policy conflict with those of OpenGL.
        """
        if renders_apart(order.policy) and not self._renders_apart:
            self.kill()
            self._renders_apart = True
        if self._process is None:
            self._start()
        self.current_order = order
        self._write(to_line(order))

    def hear(self, timeout_s: float) -> EvalReport | DriverEnded | None:
        """Returns the report of the current order, the end of the process, or `None` after a timeout or progress."""
        if self._process is None:
            return None
        try:
            report = self._reports.get(timeout=timeout_s)
        except queue.Empty:
            return self._end_if_late()
        if report is None:
            return self._reap()
        return report if self._is_outcome(report) else None

    def kill(self) -> None:
        """Kills the process immediately, if it is running."""
        process, self._process = self._process, None
        if process is not None:
            with contextlib.suppress(ProcessLookupError):
                os.killpg(process.pid, signal.SIGKILL)
            with contextlib.suppress(subprocess.TimeoutExpired):
                process.wait(_REAP_S)
            for pipe in (process.stdin, process.stdout):
                if pipe is not None:
                    with contextlib.suppress(OSError):
                        pipe.close()
        if self._sheet is not None:
            self._sheet.close()
            self._sheet = None
        if self._stderr is not None:
            self._stderr.close()
            self._stderr = None

    def _start(self) -> None:
        self._sheet = SharedStatus.fresh()
        self._stderr = tempfile.TemporaryFile(mode="a+b")  # noqa: SIM115 - closed by kill
        os.set_inheritable(self._sheet.descriptor, True)
        options = ("--render-apart",) if self._renders_apart else ()
        self._process = subprocess.Popen(
            (*CHILD, str(self._sheet.descriptor), *options),
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=self._stderr,
            pass_fds=(self._sheet.descriptor,),
            env=one_core(_environment()),
            start_new_session=True,  # Ctrl-C must reach the parent only
        )
        self._reports = queue.Queue()
        threading.Thread(target=_read, args=(self._process.stdout, self._reports), daemon=True).start()
        self._write(to_line(self.setup))

    def _is_outcome(self, report: EvalReport) -> bool:
        if report.kind is EvalReportKind.READY:
            self.renderer = report.detail
        elif report.kind is EvalReportKind.POLICY and self.current_order is not None:
            self.made[self.current_order.policy] = report.detail
        else:
            return True
        return False

    def _write(self, line: bytes) -> None:
        if self._process is not None and self._process.stdin is not None:
            with contextlib.suppress(BrokenPipeError):
                self._process.stdin.write(line)
                self._process.stdin.flush()

    def _end_if_late(self) -> DriverEnded | None:
        if self._sheet is None or self.current_order is None:
            return None
        state = self._sheet.read()
        limit_s = {
            Activity.ASKING: self.setup.act_timeout_s + _GRACE_S * self._is_remote,
            Activity.MAKING: self.setup.load_timeout_s + (_GRACE_S + self.setup.reconnect_s) * self._is_remote,
        }.get(state.busy, _SIMULATION_S)
        if time.monotonic() - state.since_s <= limit_s:
            return None
        words = self._last_output()
        self.kill()
        is_policy = state.busy in {Activity.ASKING, Activity.MAKING}
        who = "the policy did not respond" if is_policy else "the simulation made no progress"
        return DriverEnded(PolicyFault.HUNG if is_policy else None, f"{who} within {limit_s:g} s, killed{words}", state)

    @property
    def _is_remote(self) -> bool:
        return self.current_order is not None and self.current_order.policy.startswith(("ws:", "wss:"))

    def _reap(self) -> DriverEnded:
        process, sheet = self._process, self._sheet
        if process is None or sheet is None:
            raise RuntimeError("no process to close")
        state, words = sheet.read(), self._last_output()
        try:
            status = process.wait(_REAP_S)
        except subprocess.TimeoutExpired:
            status = -signal.SIGKILL  # the process closed its stdout but did not exit; kill it
        self.kill()
        how = f"killed by {signal.Signals(-status).name}" if status < 0 else f"exit status {status}"
        is_policy = state.busy in {Activity.ASKING, Activity.MAKING}
        whom = "the process died in a policy call" if is_policy else "the driver process died"
        return DriverEnded(PolicyFault.DIED if is_policy else None, f"{whom}: {how}{words}", state)

    def _last_output(self) -> str:
        if self._stderr is None:
            return ""
        end = self._stderr.seek(0, os.SEEK_END)
        self._stderr.seek(max(0, end - _TAIL_BYTES))
        lines = self._stderr.read().decode(errors="replace").strip().splitlines()
        return f"; last output: {lines[-1].strip()[:300]}" if lines else ""


def _environment() -> dict[str, str]:
    """Returns the environment of a process that can run a user's policy, whose imports must work as in a script."""
    return {name: value for name, value in child_environment(os.environ).items() if name != SAFE_PATH}


def _read(stream: IO[bytes], reports: queue.Queue[EvalReport | None]) -> None:
    with contextlib.suppress(ValueError, OSError):  # `kill` closes the stream
        for line in stream:
            report = read_report(line)
            if report is not None:
                reports.put(report)
    reports.put(None)
