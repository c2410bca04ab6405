"""Declares `factory status`: arguments, options and help."""

from __future__ import annotations

from typing import Any

import click

from factory.cli.common.options import connect_option, json_option, ledger_option, tls_option
from factory.cli.common.places import SITE


@click.command("status")
@click.argument("site", metavar="[DIR|URL]", required=False, type=SITE)
@connect_option(
    "Endpoint of a running coordinator to ask, e.g. tcp/127.0.0.1:7447; repeatable. Default: read the ledger."
)
@ledger_option
@click.option("--watch", is_flag=True, help="Refresh every second until the run has finished.")
@tls_option
@json_option
def command(**options: Any) -> None:
    """Show the progress of a run and its workers.

    Prints the number of jobs by scene, tier and split, the rate, the remaining time and the workers. Give the dataset
    (DIR or URL), or --connect. For a folder of shards, prints the last recorded state of each shard. For the
    folder of a run of `factory submit`, prints the state of its shards, or of its dataset once that exists.
    """
    from factory.commands.inspect.status import execute

    execute(**options)
