"""`--gate`: measures the success rate of first attempts in each scene before a run starts. Archives nothing.

The command line runs the gate, because the coordinator never simulates; the coordinator records the result.
"""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator
from typing import TYPE_CHECKING, Any, Literal, TypeVar

import click

from coordinator.expansion.catalog import Catalog
from coordinator.expansion.file import shrink
from factory.cli.common.bars import Bars
from factory.cli.common.output import print_table, stderr
from schemas.dataset.meta import GateOutcome
from schemas.errors import WorldError
from schemas.plan import Plan
from schemas.terms import RendererKind
from workers.client.settings import WorkerSettings

if TYPE_CHECKING:
    from factory.runs.gate import GateReport
    from factory.stats.model import Share

GateMode = Literal["auto", "enforce", "report", "skip"]
Command = TypeVar("Command", bound=Callable[..., Any])

_GATE_ATTEMPTS = 50
"""First attempts per scene, as in the paper."""
_MIN_SUCCESS = 0.8
_MIN_EPISODES_FOR_GATE = 4 * _GATE_ATTEMPTS
"""Least number of episodes for which `auto` runs the gate. Below it, the gate costs over a quarter of the run."""
_MEANINGS = (
    f"Gate before a new run: {_GATE_ATTEMPTS} first attempts in each scene. enforce: exit with 1 if less than "
    f"{100 * _MIN_SUCCESS:.0f} % succeed; report: record the result and continue; skip: no gate"
)


def gate_option(default: GateMode) -> Callable[[Command], Command]:
    """Returns the option `--gate MODE`."""
    modes = ["enforce", "report", "skip"]
    if default == "auto":
        modes.insert(0, default)
    auto = (
        f"; auto: report for scenes with at least {_MIN_EPISODES_FOR_GATE} episodes, otherwise skip"
        if default == "auto"
        else ""
    )
    return click.option(
        "--gate", "gate_mode", type=click.Choice(modes), default=default, show_default=True, help=f"{_MEANINGS}{auto}."
    )


def gate_plans(plan: Plan, mode: GateMode) -> Iterator[Plan]:
    """Yields the plan of each gate run that a mode requires; `auto` omits families, whose layouts are not built yet."""
    for scene in plan.scenes:
        if mode == "skip" or (
            mode == "auto" and (scene.layouts is not None or scene.episodes < _MIN_EPISODES_FOR_GATE)
        ):
            continue
        yield shrink(plan, scenes=(scene.name,), episodes=min(_GATE_ATTEMPTS, scene.episodes))


def measure_gate(
    plan: Plan, catalog: Catalog, mode: GateMode, renderer: RendererKind, processes: int, stop: threading.Event
) -> tuple[GateOutcome, ...] | None:
    """Runs the gate in the scenes that the mode requires; returns their outcomes, or `None` when `stop` was set.

    Raises:
        WorldError: the mode is `enforce` and the success rate in a scene is too low, or simulations do not start.
    """
    reports: list[GateReport] = []
    for part in gate_plans(plan, mode):
        report = try_scene(part, catalog, _MIN_SUCCESS, renderer, processes, stop)
        if report is None:
            return None
        reports.append(report)
    if reports:
        _print(reports)
    failed = [report.scene for report in reports if not report.passed]
    if failed and mode == "enforce":
        raise WorldError(
            f"gate failed: less than {100 * _MIN_SUCCESS:.0f} % of first attempts succeed in {', '.join(failed)}; "
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
    from factory.runs.gate import GateRun, evaluate_gate, run_gate  # only now: most runs have no gate

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
