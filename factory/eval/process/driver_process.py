"""The evaluating process's handle on one driving process: order, hear, and end it when its policy hangs.

Knows no set of episodes and no results on disk.
"""

from __future__ import annotations

import os
import time
from typing import NamedTuple

from factory.eval.driving.policy import PolicyFault
from factory.eval.models.messages import DriverOrder, EvalReport, EvalReportKind, EvalTask, Setup, read_report, to_line
from factory.eval.policies import renders_apart
from factory.eval.process.shared_status import Activity, DriverStatus, SharedStatus
from schemas.support.child import SAFE_PATH, child_environment, python_module
from schemas.support.jsonl_process import JsonlProcess, describe_exit
from workers.process.one_core import one_core

__all__ = ["CHILD", "DriverEnded", "DriverProcess"]

CHILD = python_module("factory.eval.process.child")
_SIMULATION_S = 120.0
_GRACE_S = 5.0
"""What a policy that keeps its own time limit is given beyond it."""
_MOST_WORDS_CHARS = 300


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
        self._process: JsonlProcess[EvalReport] | None = None
        self._sheet: SharedStatus | None = None
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
        self._process = self._process or self._start()
        self.current = task
        self._process.send(to_line(order))

    def hear(self, timeout_s: float) -> EvalReport | DriverEnded | None:
        """Returns what came of its task, its end, or `None` after `timeout_s` or news on the way."""
        if self._process is None:
            return None
        try:
            report = self._process.read(timeout_s)
        except EOFError:
            return self._reap(self._process)
        if report is None:
            return self._end_if_late(self._process)
        return report if self._is_outcome(report) else None

    def kill(self) -> None:
        """Ends the process at once, if there is one."""
        process, self._process = self._process, None
        if process is not None:
            process.kill()
        if self._sheet is not None:
            self._sheet.close()
            self._sheet = None

    def _start(self) -> JsonlProcess[EvalReport]:
        self._sheet = SharedStatus.fresh()
        os.set_inheritable(self._sheet.descriptor, True)
        options = ("--render-apart",) if self._renders_apart else ()
        return JsonlProcess(
            (*CHILD, str(self._sheet.descriptor), *options),
            one_core(_environment()),
            read_report,
            pass_fds=(self._sheet.descriptor,),
        )

    def _is_outcome(self, report: EvalReport) -> bool:
        if report.kind is EvalReportKind.READY:
            self.renderer = report.detail
        elif report.kind is EvalReportKind.POLICY and self.current is not None:
            self.made[self.current.policy] = report.detail
        else:
            return True
        return False

    def _end_if_late(self, process: JsonlProcess[EvalReport]) -> DriverEnded | None:
        if self._sheet is None or self.current is None:
            return None
        state, setup = self._sheet.read(), self.current.setup
        limit_s = {
            Activity.ASKING: setup.act_timeout_s + _GRACE_S * self._is_remote,
            Activity.MAKING: setup.load_timeout_s + (_GRACE_S + setup.reconnect_s) * self._is_remote,
        }.get(state.busy, _SIMULATION_S)
        if time.monotonic() - state.since_s <= limit_s:
            return None
        words = _last_output(process)
        self.kill()
        is_policy = state.busy in {Activity.ASKING, Activity.MAKING}
        who = "no answer from the policy" if is_policy else "no progress of the simulation"
        return DriverEnded(PolicyFault.HUNG if is_policy else None, f"{who} within {limit_s:g} s, killed{words}", state)

    @property
    def _is_remote(self) -> bool:
        return self.current is not None and self.current.policy.startswith(("ws:", "wss:"))

    def _reap(self, process: JsonlProcess[EvalReport]) -> DriverEnded:
        assert self._sheet is not None
        state, how = self._sheet.read(), describe_exit(process.wait()) + _last_output(process)
        self.kill()
        is_policy = state.busy in {Activity.ASKING, Activity.MAKING}
        whom = "the process died in the policy" if is_policy else "the driving process died"
        return DriverEnded(PolicyFault.DIED if is_policy else None, f"{whom}: {how}", state)


def _last_output(process: JsonlProcess[EvalReport]) -> str:
    line = process.last_stderr_line()
    return f"; last output: {line[:_MOST_WORDS_CHARS]}" if line else ""


def _environment() -> dict[str, str]:
    """Returns the surroundings of a process that may run a policy of the user's, whose own scripts import as usual."""
    return {name: value for name, value in child_environment(os.environ).items() if name != SAFE_PATH}
