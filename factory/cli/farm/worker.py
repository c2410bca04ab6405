"""Declares `factory worker`: arguments, options and help."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from factory.cli.common.options import (
    connect_option,
    count_option,
    former_option,
    number_option,
    renderer_option,
    tls_option,
    verbose_option,
)


@click.command("worker")
@count_option("--cores", 1, "Number of simulation processes, one per core.", most=1024)
@former_option("--workers", "cores", "--cores", type=click.IntRange(1, 1024))
@connect_option(
    "Endpoint of a coordinator or gateway, repeatable. The worker uses one and switches to another if it becomes "
    "unreachable. Default: tcp/127.0.0.1:7447; with --tls: tls/127.0.0.1:7447."
)
@renderer_option
@click.option(
    "--spool",
    type=click.Path(path_type=Path),
    metavar="DIR",
    help="Directory of finished bundles that the coordinator has not fetched yet. Default: in the user's cache.",
)
@number_option(
    "SECONDS",
    "--connect-timeout",
    30.0,
    "Timeout for the first connection to a coordinator, seconds.",
    "wait_s",
    least=0.0,
)
@former_option("--wait", "wait_s", "--connect-timeout", type=click.FloatRange(0.0))
@click.option("--import-policies", is_flag=True, help="Allow evaluations to import policy classes on this host.")
@click.option("--until-eof", is_flag=True, hidden=True, help="Stop when stdin is closed.")
@tls_option
@verbose_option
def command(**options: Any) -> int:
    """Simulate jobs of a coordinator on this host.

    The worker exits when the run has finished. On SIGTERM it returns its running jobs to the coordinator and exits.
    """
    from factory.commands.farm.worker import execute

    return execute(**options)
