"""Acceptance gate of the paper: runs the first attempt at each episode of a scene and counts the successes.

Attempts run in simulation processes like those of workers. A bundle is deleted when it is complete; none is archived.
"""

from __future__ import annotations

import tempfile
import threading
from collections import Counter, deque
from collections.abc import Callable, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path

from coordinator.expansion.catalog import Catalog
from coordinator.expansion.draw import expand, to_job
from factory.stats.measures import share_of
from factory.stats.statistics import Share
from schemas.base import Fraction, Model
from schemas.errors import WorldError
from schemas.job import Job
from schemas.plan import Plan
from schemas.terms import FailReason, Recording, Tier
from workers.process.messages import SimulationOrder, SimulationReport, SimulationReportKind
from workers.process.simulation import ProcessEnd, Simulation

_POLL_S = 0.1
_HANG_S = 60.0
_STARTS = 3


@dataclass(frozen=True)
class GateRun:
    """Jobs and settings of a gate run."""

    jobs: tuple[Job, ...]
    packages: Mapping[str, Path]
    """Path of the compiled scene by its name."""
    command: tuple[str, ...]
    """Command line of a simulation process."""
    processes: int = 1

    @classmethod
    def of(cls, plan: Plan, catalog: Catalog, command: tuple[str, ...], processes: int) -> GateRun:
        """Returns a gate run of the first attempts at all episodes of a plan with one scene or one family.

        The attempts record states, because their frames are deleted; the recording does not change their outcome.

        Raises:
            InvalidPlan: The scene cannot fulfil the plan.
        """
        unseen = plan.model_copy(update={"record": Recording.STATES})
        jobs = tuple(to_job(unseen, catalog, planned, attempt=1) for planned in expand(unseen, catalog))
        packages = {job.scene: catalog[job.scene].path for job in jobs}
        return cls(jobs, packages, command, processes)


@dataclass(frozen=True)
class Trial:
    """Result of one first attempt; `reason` is `None` for a success."""

    job: Job
    reason: FailReason | None = None
    detail: str = ""


class FailedTrial(Model):
    """Failed first attempt."""

    episode_id: str
    tier: Tier
    target_id: str
    reason: FailReason
    detail: str


class GateReport(Model):
    """Report of the acceptance gate."""

    scene: str
    expert: str
    min_success: Fraction
    passed: bool
    success: Share
    by_tier: dict[Tier, Share]
    reasons: dict[FailReason, int]
    lost: tuple[FailedTrial, ...]
    """Failed trials in the order of the plan."""


def run_gate(run: GateRun, stop: threading.Event, tell: Callable[[int], None]) -> list[Trial]:
    """Runs every job once and returns the trials; if `stop` is set, returns only the trials that have ended.

    Args:
        run: Jobs and settings.
        stop: Event that stops the gate run immediately.
        tell: Progress callback, called with the number of finished attempts.

    Raises:
        WorldError: Simulations do not start, or the disk of temporary files is full.
    """
    # not an ordinary run with one attempt per episode, which would archive gigabytes only to count the successes
    waiting, trials = deque(run.jobs), list[Trial]()
    with tempfile.TemporaryDirectory(prefix="gate-") as folder, ExitStack() as stack:
        count = min(run.processes, len(run.jobs))
        slots = [_TrialProcess(run, Path(folder) / f"{number}.zip", count) for number in range(count)]
        for slot in slots:
            stack.callback(slot.close)
        while len(trials) < len(run.jobs) and not stop.is_set():
            for slot in slots:
                trial = slot.turn(waiting)
                if trial is not None:
                    trials.append(trial)
                    tell(len(trials))
    return trials


def evaluate_gate(scene: str, expert: str, trials: Sequence[Trial], min_success: float) -> GateReport:
    """Counts trials by tier and reason and compares the share of successes with the required one.

    A crash counts as a failed attempt, because the gate measures whether episodes can be generated in the scene.
    """
    won = Counter(trial.job.tier for trial in trials if trial.reason is None)
    tried = Counter(trial.job.tier for trial in trials)
    lost = [
        FailedTrial(
            episode_id=trial.job.episode_id,
            tier=trial.job.tier,
            target_id=trial.job.target_id,
            reason=trial.reason,
            detail=trial.detail,
        )
        for trial in sorted(trials, key=lambda trial: trial.job.index)
        if trial.reason is not None
    ]
    success = share_of(won.total(), len(trials))
    return GateReport(
        scene=scene,
        expert=expert,
        min_success=min_success,
        passed=success.share is not None and success.share >= min_success,
        success=success,
        by_tier={tier: share_of(won[tier], tried[tier]) for tier in Tier if tried[tier]},
        reasons=dict(sorted(Counter(row.reason for row in lost).items())),
        lost=tuple(lost),
    )


class _TrialProcess:
    """Simulation process and its current job; all processes are polled in turn, so no call may block for long."""

    def __init__(self, run: GateRun, bundle: Path, slots: int) -> None:
        self._run, self._bundle = run, bundle
        self._poll_s = _POLL_S / slots
        # `receive` counts only the time that it waits itself: 1/slots of the total, because the processes take turns
        limit_s = _HANG_S / slots
        self._simulation = Simulation(run.command, limit_s, limit_s)
        self._job: Job | None = None
        self._is_ready = False
        self._starts = 0

    def close(self) -> None:
        self._simulation.kill()

    def turn(self, waiting: deque[Job]) -> Trial | None:
        """Starts the process, sends a job or polls it; returns a finished trial, if any."""
        if self._job is None and not waiting:
            return None
        if not self._simulation.is_running:
            self._is_ready = False
            self._simulation.start()
        elif self._is_ready and self._job is None:
            self._order(waiting.popleft())
        heard = self._simulation.receive(self._poll_s)
        if isinstance(heard, ProcessEnd):
            return self._handle_end(heard, waiting)
        return None if heard is None else self._handle_report(heard)

    def _order(self, job: Job) -> None:
        self._job = job
        self._simulation.order(
            SimulationOrder(job=job, scene_path=self._run.packages[job.scene], bundle_path=self._bundle, sid="gate")
        )

    def _handle_report(self, report: SimulationReport) -> Trial | None:
        if report.kind is SimulationReportKind.READY:
            self._is_ready, self._starts = True, 0
        if report.kind in {SimulationReportKind.READY, SimulationReportKind.PROGRESS} or self._job is None:
            return None
        if report.reason is FailReason.RELEASED:  # the disk is full, which is not a failure of the scene
            raise WorldError(f"{report.detail}; free space in the folder of temporary files, or set TMPDIR")
        job, self._job = self._job, None
        self._bundle.unlink(missing_ok=True)
        return Trial(job, report.reason, report.detail)

    def _handle_end(self, end: ProcessEnd, waiting: deque[Job]) -> Trial | None:
        job, self._job = self._job, None
        if job is not None and end.reason is FailReason.RELEASED:
            waiting.appendleft(job)
            return None
        if job is not None:
            return Trial(job, end.reason, end.detail)
        self._starts += 1
        if self._starts >= _STARTS:
            command = " ".join(self._run.command)
            raise WorldError(f"the simulation did not start after {_STARTS} tries of `{command}`: {end.detail}")
        return None
