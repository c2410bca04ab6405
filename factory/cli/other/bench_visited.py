"""Declares `factory bench visited`: arguments, options and help."""

from __future__ import annotations

from typing import Any

import click

from factory.cli.options import count_option, json_option, number_option, plan_argument, workers_option


@click.command("visited")
@plan_argument(default="demo")
@workers_option("Number of simulation processes")
@number_option("SECONDS", "--seconds", 60.0, "Duration of each period, seconds.", least=1.0)
@count_option("--rounds", 5, "Number of periods of each kind.")
@count_option("--viewers", 5, "Number of viewers.", most=100)
@count_option("--requests", 10_000, "Number of hostile requests of a period with attackers.")
@json_option
def visited(**options: Any) -> None:
    """Measure what visitors of the web page cost a run.

    Starts a run of PLAN with `--record states` and its web page, in a temporary directory. Periods without visitors,
    with viewers and with attackers alternate. Attackers send hostile requests and keep slow connections open.
    """
    from factory.commands.other.bench_visited import visited

    visited(**options)
