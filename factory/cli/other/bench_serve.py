"""Declares `factory bench serve`: arguments, options and help."""

from __future__ import annotations

from typing import Any

import click

from factory.cli.options import count_option, json_option, number_option, place_argument


@click.command("serve")
@place_argument
@count_option("--repeats", 10, "Number of timed requests of each page.", least=2)
@count_option("--tabs", 100, "Number of open farm pages.", most=300)
@number_option("SECONDS", "--seconds", 60.0, "Time for which the tabs are open, seconds.", least=1.0)
@json_option
def serve(**options: Any) -> None:
    """Measure the web page of a dataset, or of a run in progress.

    Starts `factory serve` and measures its pages, frames and playback, and its CPU time with and without open tabs.
    """
    from factory.commands.other.bench_serve import serve

    serve(**options)
