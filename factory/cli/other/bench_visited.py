"""`factory bench visited`: measures what viewers and attackers of the web page cost a run."""

from __future__ import annotations

import os

import click

from factory.bench.model import Spread
from factory.bench.visited import VisitedBench, bench_visited
from factory.cli.common.options import count_option, number_option, plan_argument
from factory.cli.common.output import json_option, print_result, print_table
from schemas.support.extras import require_package


@click.command("visited")
@plan_argument(default="demo")
@count_option("--workers", os.cpu_count() or 1, "Number of simulations.")
@number_option("SECONDS", "--seconds", 60.0, "Duration of each period, seconds.", least=1.0)
@count_option("--rounds", 5, "Number of periods of each kind.")
@count_option("--viewers", 5, "Number of viewers.", most=100)
@count_option("--requests", 10_000, "Number of hostile requests of a period with attackers.")
@json_option
def visited(
    plan_name: str, workers: int, seconds: float, rounds: int, viewers: int, requests: int, as_json: bool
) -> None:
    """Measure what visitors of the web page cost a run.

    Starts a run of states of PLAN with its web page, in a temporary directory. Measures periods without visitors, with
    viewers, and with attackers in turn: hostile requests, and a hundred slow clients.
    """
    require_package("starlette", "`factory bench visited`")
    print_result(bench_visited(plan_name, workers, seconds, rounds, viewers, requests), as_json, _show)


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
