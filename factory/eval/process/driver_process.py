"""The evaluating process's handle on one driving process: order, hear, and end it when its policy hangs.

Knows no set of episodes and no results on disk.
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
from factory.eval.models.messages import DriverOrder, EvalReport, EvalReportKind, EvalTask, Setup, read_report, to_line
from factory.eval.policies import renders_apart
from factory.eval.process.shared_status import Activity, DriverStatus, SharedStatus
from schemas.support.child import SAFE_PATH, child_environment, python_module
from workers.process.one_core import one_core

__all__ = ["CHILD", "DriverEnded", "DriverProcess"]

CHILD = python_module("factory.eval.process.child")
_SIMULATION_S = 120.0
_GRACE_S = 5.0
"""What a policy that keeps its own time limit is given beyond it."""
_TAIL_BYTES = 4000
_REAP_S = 3.0


class DriverEnded(NamedTuple):
    """A driving process is no more; it has been reaped."""

    fault: PolicyFault | None
    """What the policy did, or `None` where it was not being asked."""
    detail: str
    state: DriverStatus
    """What it was at."""


class DriverProcess:
    """One driving process, started again when needed."""

    def __init__(self) -> None:
        self._setup: Setup | None = None
        self._renders_apart = False
        self._process: subprocess.Popen[bytes] | None = None
        self._reports: queue.Queue[EvalReport | None] = queue.Queue()
        self._sheet: SharedStatus | None = None
        self._stderr: IO[bytes] | None = None
        self.current: EvalTask | None = None
        """What it is driving."""
        self.made: dict[str, str] = {}
        """What the policies that could be made here go by."""
        self.renderer = ""
        """What draws here, once it is known."""

    @property
    def pid(self) -> int | None:
        """Of the process, if there is one."""
        return self._process.pid if self._process is not None else None

    @property
    def steps(self) -> int:
        """Of the episode that is being driven."""
        return self._sheet.read().steps if self._sheet is not None else 0

    def give(self, order: DriverOrder) -> None:
        """Sends an order, to a new process where there is none; its death is heard from `hear`.

        A process of another campaign is replaced, and so is one that renders by itself where the policy's libraries
        must not meet OpenGL's.
        """
        task = order.task
        if task.setup != self._setup:
            self.kill()
            self._setup, self.made = task.setup, {}
        if renders_apart(task.policy) and not self._renders_apart:
            self.kill()
            self._renders_apart = True
        if self._process is None:
            self._start()
        self.current = task
        self._write(to_line(order))

    def hear(self, timeout_s: float) -> EvalReport | DriverEnded | None:
        """Returns what came of its task, its end, or `None` after `timeout_s` or news on the way."""
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
        """Ends the process at once, if there is one."""
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
            start_new_session=True,  # Ctrl-C is for the caller
        )
        self._reports = queue.Queue()
        threading.Thread(target=_read, args=(self._process.stdout, self._reports), daemon=True).start()

    def _is_outcome(self, report: EvalReport) -> bool:
        if report.kind is EvalReportKind.READY:
            self.renderer = report.detail
        elif report.kind is EvalReportKind.POLICY and self.current is not None:
            self.made[self.current.policy] = report.detail
        else:
            return True
        return False

    def _write(self, line: bytes) -> None:
        if self._process is not None and self._process.stdin is not None:
            with contextlib.suppress(BrokenPipeError):
                self._process.stdin.write(line)
                self._process.stdin.flush()

    def _end_if_late(self) -> DriverEnded | None:
        if self._sheet is None or self.current is None:
            return None
        state, setup = self._sheet.read(), self.current.setup
        limit_s = {
            Activity.ASKING: setup.act_timeout_s + _GRACE_S * self._is_remote,
            Activity.MAKING: setup.load_timeout_s + (_GRACE_S + setup.reconnect_s) * self._is_remote,
        }.get(state.busy, _SIMULATION_S)
        if time.monotonic() - state.since_s <= limit_s:
            return None
        words = self._last_output()
        self.kill()
        is_policy = state.busy in {Activity.ASKING, Activity.MAKING}
        who = "no answer from the policy" if is_policy else "no progress of the simulation"
        return DriverEnded(PolicyFault.HUNG if is_policy else None, f"{who} within {limit_s:g} s, killed{words}", state)

    @property
    def _is_remote(self) -> bool:
        return self.current is not None and self.current.policy.startswith(("ws:", "wss:"))

    def _reap(self) -> DriverEnded:
        process, sheet = self._process, self._sheet
        if process is None or sheet is None:
            raise RuntimeError("no process to close")
        state, words = sheet.read(), self._last_output()
        try:
            status = process.wait(_REAP_S)
        except subprocess.TimeoutExpired:
            status = -signal.SIGKILL  # closed its stdout and lives on: not ours any more
        self.kill()
        how = f"killed by {signal.Signals(-status).name}" if status < 0 else f"exit status {status}"
        is_policy = state.busy in {Activity.ASKING, Activity.MAKING}
        whom = "the process died in the policy" if is_policy else "the driving process died"
        return DriverEnded(PolicyFault.DIED if is_policy else None, f"{whom}: {how}{words}", state)

    def _last_output(self) -> str:
        if self._stderr is None:
            return ""
        end = self._stderr.seek(0, os.SEEK_END)
        self._stderr.seek(max(0, end - _TAIL_BYTES))
        lines = self._stderr.read().decode(errors="replace").strip().splitlines()
        return f"; last output: {lines[-1].strip()[:300]}" if lines else ""


def _environment() -> dict[str, str]:
    """Returns the surroundings of a process that may run a policy of the user's, whose own scripts import as usual."""
    return {name: value for name, value in child_environment(os.environ).items() if name != SAFE_PATH}


def _read(stream: IO[bytes], reports: queue.Queue[EvalReport | None]) -> None:
    with contextlib.suppress(ValueError, OSError):  # closed under our hands when killed
        for line in stream:
            report = read_report(line)
            if report is not None:
                reports.put(report)
    reports.put(None)
