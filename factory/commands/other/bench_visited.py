"""`factory bench visited`: measures what viewers and attackers of the web page cost a run."""

from __future__ import annotations

import os

from factory.bench.results import Spread
from factory.bench.service.visited import VisitedBench, bench_visited
from factory.support.terminal import print_result, print_table
from schemas.support.extras import require_package


def visited(
    plan_name: str, workers: int | None, seconds: float, rounds: int, viewers: int, requests: int, as_json: bool
) -> None:
    """Executes `factory bench visited`."""
    require_package("starlette", "`factory bench visited`")
    report = bench_visited(plan_name, workers or os.cpu_count() or 1, seconds, rounds, viewers, requests)
    print_result(report, as_json, _show)


def _show(report: VisitedBench) -> None:
    rows = [
        (
            kind,
            _spread(cost.episodes_per_s),
            _spread(cost.coordinator_share, 100),
            _spread(cost.cpu_s_per_episode),
        )
        for kind, cost in report.costs.items()
    ]
    title = (
        f"Run of {report.plan}, {report.rounds} periods of {report.seconds:g} s each: {report.viewers} viewers, or "
        f"{report.requests} hostile requests"
    )
    print_table(title, ("visitors", "episodes/s", "coordinator, % of a core", "CPU s per episode"), rows)


def _spread(value: Spread, factor: float = 1.0) -> str:
    median, low, high = (factor * part for part in (value.median, value.low, value.high))
    return f"{median:.3g} ({low:.3g} to {high:.3g})"
