"""`--gate`: measures the success rate of first attempts in each scene before a run starts. Archives nothing.

The command line runs the gate, because the coordinator never simulates; the coordinator records the result.
"""

from __future__ import annotations

import threading
from collections.abc import Iterator
from typing import TYPE_CHECKING

from coordinator.expansion.catalog import Catalog
from coordinator.expansion.plan_file import shrink
from factory.commands.common.bars import Bars
from factory.commands.common.gate_mode import GATE_ATTEMPTS, MIN_EPISODES_FOR_GATE, MIN_SUCCESS, GateMode
from factory.commands.common.output import print_table, stderr
from schemas.dataset.meta import GateOutcome
from schemas.errors import WorldError
from schemas.plan import Plan
from schemas.terms import RendererKind
from workers.client.settings import WorkerSettings

if TYPE_CHECKING:
    from factory.runs.gate import GateReport
    from factory.stats.statistics import Share


def gate_plans(plan: Plan, mode: GateMode) -> Iterator[Plan]:
    """Yields the plan of each gate run that a mode requires; `auto` omits families, whose layouts are not built yet."""
    for scene in plan.scenes:
        if mode == "skip" or (mode == "auto" and (scene.layouts is not None or scene.episodes < MIN_EPISODES_FOR_GATE)):
            continue
        yield shrink(plan, scenes=(scene.name,), episodes=min(GATE_ATTEMPTS, scene.episodes))


def measure_gate(
    plan: Plan, catalog: Catalog, mode: GateMode, renderer: RendererKind, processes: int, stop: threading.Event
) -> tuple[GateOutcome, ...] | None:
    """Runs the gate in the scenes that the mode requires; returns their outcomes, or `None` when `stop` was set.

    Raises:
        WorldError: the mode is `enforce` and the success rate in a scene is too low, or simulations do not start.
    """
    reports: list[GateReport] = []
    for part in gate_plans(plan, mode):
        report = try_scene(part, catalog, MIN_SUCCESS, renderer, processes, stop)
        if report is None:
            return None
        reports.append(report)
    if reports:
        _print(reports)
    failed = [report.scene for report in reports if not report.passed]
    if failed and mode == "enforce":
        raise WorldError(
            f"gate failed: less than {100 * MIN_SUCCESS:.0f} % of first attempts succeed in {', '.join(failed)}; "
            f"nothing was archived; list the failures with `factory gate --scene {failed[0]}`, or continue with "
            "--gate report"
        )
    return tuple(map(_outcome, reports))


def try_scene(
    plan: Plan, catalog: Catalog, min_success: float, renderer: RendererKind, processes: int, stop: threading.Event
) -> GateReport | None:
    """Attempts every episode of a one-scene plan once; returns the report, or `None` when `stop` was set.

    Shows a progress bar.

    Raises:
        WorldError: simulations do not start.
    """
    from factory.runs.gate import GateRun, evaluate_gate, run_gate  # needed only for a gate

    run = GateRun.of(plan, catalog, WorkerSettings(connect=(), renderer=renderer).simulation_command, processes)
    name = plan.scenes[0].name
    with Bars() as bar:
        task = bar.add_task(f"gate {name}", total=len(run.jobs))
        trials = run_gate(run, stop, lambda done: bar.update(task, completed=done))
    return None if len(trials) < len(run.jobs) else evaluate_gate(name, plan.expert, trials, min_success)


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


def _print(reports: list[GateReport]) -> None:
    rows = [
        (
            report.scene,
            report.success.of,
            report.success.count,
            _percent(report.success),
            ", ".join(f"{count} {reason}" for reason, count in report.reasons.items()) or "-",
            "passed" if report.passed else "failed",
        )
        for report in reports
    ]
    print_table("", ("gate", "first attempts", "succeeded", "success", "failures", "result"), rows, stderr)


def _percent(share: Share) -> str:
    return "-" if share.share is None else f"{100 * share.share:.0f} %"
