"""Declares `factory serve`: arguments, options and help."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from factory.cli.common.http import evaluations_option
from factory.cli.common.options import ledger_option, site_argument, tls_option, verbose_option

_DEFAULT = "127.0.0.1:8080"


@click.command("serve")
@site_argument
@click.option(
    "--http",
    metavar="HOST:PORT",
    default=_DEFAULT,
    show_default=True,
    help="Address to serve on; port 0 selects a free port. An address that other machines can reach requires "
    "--http-token or --tls.",
)
@click.option(
    "--http-token",
    type=click.Path(path_type=Path, dir_okay=False),
    metavar="FILE",
    help="File whose first line is the token that every request requires. Default: a random token, "
    "required only for requests that change something.",
)
@evaluations_option
@tls_option
@ledger_option
@verbose_option
def command(**options: Any) -> None:
    """Serve the web page of a dataset and its run.

    Ends with Ctrl-C. Shows progress, workers, failures, episodes, scenes and statistics of a running or finished
    dataset. The printed URL contains the token, with which flags, notes and jobs can be changed.
    """
    from factory.commands.inspect.serve import execute

    execute(**options)
