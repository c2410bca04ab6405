"""Manages one driver process: sends orders, receives reports, and kills the process when its policy hangs.

A killed or dead process gives a failed result. Does not select episodes and does not store results.
"""

from __future__ import annotations

import os
import time
from typing import NamedTuple

from factory.eval.driving.policy import PolicyFault
from factory.eval.driving.rollout import progresses, request_fields
from factory.eval.models.messages import (
    DriverOrder,
    EvalReport,
    EvalReportKind,
    EvalSetup,
    EvalTask,
    PolicyLimits,
    read_report,
    to_line,
)
from factory.eval.models.result import EpisodeResult, EvalEnd
from factory.eval.policies.registry import is_user_class, renders_apart
from factory.eval.process.shared_status import Activity, DriverStatus, SharedStatus
from schemas.protocol.messages import PolicyWait
from schemas.support.child import SAFE_PATH, child_environment, python_module
from schemas.support.child_process import ChildProcess, Ended
from workers.process.one_core import one_core

CHILD = python_module("factory.eval.process.child")
_SIMULATION_S = 120.0
"""Time limit of an activity that is not a call of the policy, seconds: opening the renderer, loading a scene, a step,
or computing metrics."""
# no progress is reported within an activity, so the limit is twice that of a simulation in data collection
# (`WorkerSettings.hang_s`)
_GRACE_S = 5.0
"""Additional time before a process with a policy on a server is killed, seconds. Such a policy enforces its time limit
itself."""
_LEAVE_S = 2.0
"""Time for a process to close the connection to its policy server, seconds."""
_MOST_OUTPUT_CHARS = 300


_LONG_WAIT_S = 2.0
"""Time after which a wait for a policy is shown, seconds."""


def describe_wait(wait: PolicyWait, limits: PolicyLimits) -> str:
    """Returns what a policy is waited for, and for how long at most."""
    if wait is PolicyWait.FIRST:
        return f"waiting for loading, reset or first answer, at most {limits.load_timeout_s:g} s (--load-timeout)"
    return f"waiting for an answer, at most {limits.act_timeout_s:g} s (--act-timeout)"


class DriverEnded(NamedTuple):
    """End of a driver process, which has been reaped."""

    fault: PolicyFault | None
    """Kind of the policy failure; `None` if no policy call was in progress."""
    detail: str
    state: DriverStatus
    """Last shared status of the process."""


class DriverProcess:
    """Driver process, restarted when needed."""

    def __init__(self) -> None:
        self._setup: EvalSetup | None = None
        self._renders_apart = False
        self._imported = ""
        """User class that the process has imported; empty without one."""
        self._process = ChildProcess(read_report, leave_s=_LEAVE_S)
        self._status: SharedStatus | None = None
        self.current: EvalTask | None = None
        """Task in progress; `None` without one."""
        self.made: dict[str, EvalReport] = {}
        """Policy name -> report of its creation, for policies created in this process: the information that it uses,
        the hashes of what it consists of, and its training."""
        self.renderer = ""
        """Description of the renderer; empty until the process reports it."""

    @property
    def long_wait(self) -> PolicyWait | None:
        """What the process waits for, if it has waited for the policy for more than two seconds; `None` otherwise."""
        if self._status is None or self.current is None:
            return None
        state = self._status.read()
        wait = {Activity.MAKING: PolicyWait.FIRST, Activity.ASKING: PolicyWait.ANSWER}.get(state.busy)
        return wait if time.monotonic() - state.since_s > _LONG_WAIT_S else None

    @property
    def pid(self) -> int | None:
        """Process id; `None` without a running process."""
        return self._process.pid

    @property
    def steps(self) -> int:
        """Number of steps of the current episode."""
        return self._status.read().steps if self._status is not None else 0

    def send(self, order: DriverOrder) -> None:
        """Sends an order; starts a process if none is running. `poll` reports the end of the process.

        A process of another campaign is replaced. A process that renders itself is also replaced if the policy's
        libraries conflict with those of OpenGL, and one that has imported another user class, whose modules would be
        hashed as parts of this one.
        """
        task = order.task
        if task.setup != self._setup:
            self.kill()
            self._setup, self.made = task.setup, {}
        if renders_apart(task.reference) and not self._renders_apart:
            self.kill()
            self._renders_apart = True
        if is_user_class(task.reference):
            if self._imported not in ("", task.reference):
                self.kill()
            self._imported = task.reference
        if not self._process.is_started:
            self._start()
        self.current = task
        self._process.send(to_line(order))

    def poll(self, timeout_s: float) -> EvalReport | DriverEnded | None:
        """Returns the outcome of the current order, the end of the process, or `None` if there is no outcome yet."""
        if not self._process.is_started:
            return None
        report = self._process.receive(timeout_s)
        if report is None:
            return self._end_if_late()
        if isinstance(report, Ended):
            return self._end_of(report)
        return report if self._is_outcome(report) else None

    def kill(self) -> Ended | None:
        """Kills the process immediately; returns its end, or `None` if it is not running."""
        end = self._process.kill()
        if self._status is not None:
            self._status.close()
            self._status = None
        return end

    def _start(self) -> None:
        self._status = SharedStatus.fresh()
        descriptor = self._status.descriptor
        options = ("--render-apart",) if self._renders_apart else ()
        self._process.start((*CHILD, str(descriptor), *options), one_core(_environment()), (descriptor,))

    def _is_outcome(self, report: EvalReport) -> bool:
        if report.kind is EvalReportKind.READY:
            self.renderer = report.detail
        elif report.kind is EvalReportKind.POLICY and self.current is not None:
            self.made[self.current.policy] = report
        else:
            return True
        return False

    def _end_if_late(self) -> DriverEnded | None:
        if self._status is None or self.current is None:
            return None
        state, setup = self._status.read(), self.current.setup
        limit_s = {
            Activity.ASKING: setup.act_timeout_s + _GRACE_S * self._is_remote,
            Activity.MAKING: setup.load_timeout_s + (_GRACE_S + setup.reconnect_s) * self._is_remote,
        }.get(state.busy, _SIMULATION_S)
        if time.monotonic() - state.since_s <= limit_s:
            return None
        last_output = _last_output(self.kill())
        is_policy = state.busy in {Activity.ASKING, Activity.MAKING}
        who = "the policy did not respond" if is_policy else "the simulation made no progress"
        return DriverEnded(
            PolicyFault.HUNG if is_policy else None, f"{who} for {limit_s:g} s, killed{last_output}", state
        )

    @property
    def _is_remote(self) -> bool:
        return self.current is not None and self.current.reference.startswith(("ws:", "wss:"))

    def _end_of(self, end: Ended) -> DriverEnded:
        assert self._status is not None
        state, how = self._status.read(), end.description + _last_output(end)
        self.kill()
        is_policy = state.busy in {Activity.ASKING, Activity.MAKING}
        whom = "the driver process died while the policy ran" if is_policy else "the driver process died"
        return DriverEnded(PolicyFault.DIED if is_policy else None, f"{whom}: {how}", state)


def _last_output(end: Ended | None) -> str:
    return f"; last output: {end.last_output[:_MOST_OUTPUT_CHARS]}" if end is not None and end.last_output else ""


def _environment() -> dict[str, str]:
    """Returns the environment of a process that can run a user's policy, whose imports must work as in a script."""
    return {name: value for name, value in child_environment(os.environ).items() if name != SAFE_PATH}


def interrupted_result(task: EvalTask, detail: str, fault: PolicyFault, state: DriverStatus) -> EpisodeResult:
    """Returns the failed result of an episode whose driver process was killed or died.

    Args:
        task: Task of the episode.
        detail: Description of the end.
        fault: Kind of the policy failure.
        state: Last shared status of the driver process.
    """
    spec = task.request.spec
    start_m = state.start_m or spec.spawn_dist_m
    now_m, least_m = (state.now_m, state.least_m) if state.start_m else (start_m, start_m)
    nothing = None if spec.geodesic_m is None else 0.0
    return EpisodeResult(
        **request_fields(task),
        end=EvalEnd(fault),
        detail=detail,
        success=False,
        any_instance=False,
        num_steps=state.steps,
        spawn_dist_m=start_m,
        trajectory_length_m=state.driven_m,
        final_ne_m=now_m,
        min_ne_m=least_m,
        spl=nothing,
        soft_spl=nothing,
        **progresses(start_m, now_m, least_m, task.setup.settings.task),
        contact_steps=state.contact_steps,
        clipped_actions=0,
        act_ms=0.0,
        seconds=0.0,
        track=(spec.spawn_pose,),
    )
