"""`factory bench serve`: measures the web page of a dataset."""

from __future__ import annotations

import click

from factory.bench.reading.serve import bench_serve
from factory.cli.common.options import count_option, number_option, place_argument
from factory.cli.common.output import json_option, print_result
from factory.cli.other.bench_tables import show_serve
from schemas.storage.place import Place
from schemas.support.extras import require_package


@click.command("serve")
@place_argument
@count_option("--repeats", 10, "Number of timed requests of each page.", least=2)
@count_option("--tabs", 100, "Number of open farm pages.", most=300)
@number_option("SECONDS", "--seconds", 60.0, "Time for which the tabs are open, seconds.", least=1.0)
@json_option
def serve(root: Place, repeats: int, tabs: int, seconds: float, as_json: bool) -> None:
    """Measure the web page of a dataset, which may be running.

    Starts `factory serve` and measures its pages, frames and playback, and its CPU time with and without open tabs.
    """
    require_package("starlette", "`factory bench serve`")
    print_result(bench_serve(root, repeats, tabs, seconds), as_json, show_serve)
