"""Acceptance gate of the paper: runs the first attempt at each episode of a scene, and prints the share of successes.

Attempts run in simulation processes like those of workers. A bundle is deleted when it is complete; none is archived.
The command line runs the gate, because the coordinator never simulates; the coordinator records the result.
"""

from __future__ import annotations

import tempfile
import threading
from collections import Counter, deque
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path

import click

from coordinator.expansion.catalog import Catalog
from coordinator.expansion.draw import expand, to_job
from coordinator.expansion.plan_file import shrink
from factory.runs.gate_mode import GATE_ATTEMPTS, MIN_EPISODES_FOR_GATE, MIN_SUCCESS, GateMode
from factory.stats.measures import share_of
from factory.stats.statistics import Share
from factory.support.terminal import Bars, print_table, print_text, stderr
from schemas.base import Fraction, Model
from schemas.dataset.meta import GateOutcome
from schemas.errors import WorldError
from schemas.job import Job
from schemas.plan import Budget, Plan
from schemas.terms import FailReason, Recording, RendererKind, Tier
from workers.client.settings import WorkerSettings
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
    most_attempts: int
    """Largest number of attempts at one episode of a run."""


def gate_plans(plan: Plan, mode: GateMode) -> Iterator[Plan]:
    """Yields the plan of each gate run that a mode requires; `auto` omits families, whose layouts are not built yet."""
    for scene in plan.scenes:
        if mode == "skip" or (mode == "auto" and (scene.layouts is not None or scene.episodes < MIN_EPISODES_FOR_GATE)):
            continue
        yield shrink(plan, scenes=(scene.name,), episodes=min(GATE_ATTEMPTS, scene.episodes))


def measure_gate(
    plan: Plan, catalog: Catalog, mode: GateMode, *, renderer: RendererKind, processes: int, stop: threading.Event
) -> tuple[GateOutcome, ...] | None:
    """Runs the gate in the scenes that the mode requires; returns their outcomes, or `None` when `stop` was set.

    Raises:
        WorldError: the mode is `enforce` and the success rate in a scene is too low, or simulations do not start.
    """
    reports: list[GateReport] = []
    for part in gate_plans(plan, mode):
        report = try_scene(part, catalog, min_success=MIN_SUCCESS, renderer=renderer, processes=processes, stop=stop)
        if report is None:
            return None
        reports.append(report)
    if reports:
        _print_outcomes(reports)
    for report in reports:
        if not report.passed and mode != "enforce":
            print_text(f"note: gate failed in {report.scene}, the run continues: {consequence_of(report)}", stderr)
    failed = [report.scene for report in reports if not report.passed]
    if failed and mode == "enforce":
        raise WorldError(
            f"gate failed: less than {100 * MIN_SUCCESS:.0f} % of first attempts succeed in {', '.join(failed)}; "
            f"nothing was archived; list the failures with `factory gate --scene {failed[0]}`, or continue with "
            "--gate report"
        )
    return tuple(map(_outcome, reports))


def try_scene(
    plan: Plan, catalog: Catalog, *, min_success: float, renderer: RendererKind, processes: int, stop: threading.Event
) -> GateReport | None:
    """Attempts every episode of a one-scene plan once; returns the report, or `None` when `stop` was set.

    Shows a progress bar.

    Raises:
        WorldError: simulations do not start.
    """
    run = GateRun.of(plan, catalog, WorkerSettings(connect=(), renderer=renderer).simulation_command, processes)
    name = plan.scenes[0].name
    with Bars() as bar:
        task = bar.add_task(f"gate {name}", total=len(run.jobs))
        trials = run_gate(run, stop, lambda done: bar.update(task, completed=done))
    return None if len(trials) < len(run.jobs) else evaluate_gate(name, plan.expert, trials, min_success, plan.budget)


def run_gate(run: GateRun, stop: threading.Event, on_progress: Callable[[int], None]) -> list[Trial]:
    """Runs every job once and returns the trials; if `stop` is set, returns only the trials that have ended.

    Args:
        run: Jobs and settings.
        stop: Event that stops the gate run immediately.
        on_progress: Progress callback, called with the number of finished attempts.

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
                    on_progress(len(trials))
    return trials


def evaluate_gate(
    scene: str, expert: str, trials: Sequence[Trial], min_success: float, budget: Budget | None = None
) -> GateReport:
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
    success, budget = share_of(won.total(), len(trials)), budget or Budget()
    return GateReport(
        scene=scene,
        expert=expert,
        min_success=min_success,
        passed=success.share is not None and success.share >= min_success,
        success=success,
        by_tier={tier: share_of(won[tier], tried[tier]) for tier in Tier if tried[tier]},
        reasons=dict(sorted(Counter(row.reason for row in lost).items())),
        lost=tuple(lost),
        most_attempts=budget.draws * budget.attempts_per_draw,
    )


def consequence_of(report: GateReport) -> str:
    """Returns what a run needs if all its attempts in a scene succeed as often as those of the gate."""
    rate, most = report.success.share or 0.0, report.most_attempts
    if rate == 0:
        return f"no attempt succeeded; an episode fails after {most} attempts, so probably all fail"
    return (
        f"about {1 / rate:.1f} attempts for each episode, i.e. {1 / rate - 1:.1f} failed ones; an episode fails after "
        f"{most} attempts, which happens to about {100 * (1 - rate) ** most:.2g} % of the episodes"
    )


def print_gate(report: GateReport) -> None:
    """Prints the report of a gate as text."""
    rows = [*((str(tier), share) for tier, share in report.by_tier.items()), ("all", report.success)]
    body = [(name, share.of, share.count, _percent(share, 1), _interval(share)) for name, share in rows]
    print_table("", ("tier", "attempts", "succeeded", "success", "95 % interval"), body)
    if report.reasons:
        click.echo("failures: " + ", ".join(f"{count} {reason}" for reason, count in report.reasons.items()))
    for row in report.lost:
        click.echo(f"  {row.episode_id} {row.tier} {row.target_id}: {row.reason}: {row.detail}")
    verdict = "passed" if report.passed else "failed"
    required = f"{100 * report.min_success:g} % required"
    success = f"{_percent(report.success, 1)} of first attempts succeeded"
    click.echo(f"{report.scene}, {report.expert} expert: {verdict}; {success}, {required}")
    if not report.passed:
        click.echo(f"a run needs {consequence_of(report)}" if report.success.count else consequence_of(report))


def _print_outcomes(reports: list[GateReport]) -> None:
    rows = [
        (
            report.scene,
            report.success.of,
            report.success.count,
            _percent(report.success, 0),
            ", ".join(f"{count} {reason}" for reason, count in report.reasons.items()) or "-",
            "passed" if report.passed else "failed",
        )
        for report in reports
    ]
    print_table("", ("gate", "first attempts", "succeeded", "success", "failures", "result"), rows, stderr)


def _outcome(report: GateReport) -> GateOutcome:
    return GateOutcome(
        scene=report.scene,
        expert=report.expert,
        attempts=report.success.of,
        succeeded=report.success.count,
        min_success=report.min_success,
        passed=report.passed,
        reasons={str(reason): count for reason, count in report.reasons.items()},
    )


def _percent(share: Share, digits: int) -> str:
    return "-" if share.share is None else f"{100 * share.share:.{digits}f} %"


def _interval(share: Share) -> str:
    return "-" if share.low is None or share.high is None else f"{100 * share.low:.1f} to {100 * share.high:.1f} %"


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
        report = self._simulation.receive(self._poll_s)
        if isinstance(report, ProcessEnd):
            return self._handle_end(report, waiting)
        return None if report is None else self._handle_report(report)

    def _order(self, job: Job) -> None:
        self._job = job
        self._simulation.order(
            SimulationOrder(job=job, scene_path=self._run.packages[job.scene], bundle_path=self._bundle, sid="gate")
        )

    def _handle_report(self, report: SimulationReport) -> Trial | None:
        if report.kind is SimulationReportKind.READY:
            self._is_ready = True
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
        if self._simulation.failed_starts >= _STARTS:
            command = " ".join(self._run.command)
            raise WorldError(f"the simulation did not start after {_STARTS} tries of `{command}`: {end.detail}")
        return None
