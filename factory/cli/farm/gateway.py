"""Declares `factory gateway`: arguments, options and help."""

from __future__ import annotations

from typing import Any

import click

from factory.cli.common.groups import CommandGroup
from factory.cli.common.http import http_options
from factory.cli.common.options import connect_option, listen_option, tls_option, verbose_option, write_option


@click.group("gateway", cls=CommandGroup)
def command() -> None:
    """Start a gateway between workers and a coordinator."""


@command.command("start")
@connect_option("Endpoint of the coordinator; repeatable.", required=True)
@write_option(
    "DIR", "Directory of this gateway's episodes. An existing one is continued.", "root", required=True, file_okay=False
)
@listen_option(
    "Endpoint to listen on for workers, repeatable; port 0 selects a free port. Default: tcp/127.0.0.1:7448; with "
    "--tls: tls/0.0.0.0:7447."
)
@click.option(
    "--name", metavar="NAME", help="Name of this gateway. Default: the host name; with --tls: that of the certificate."
)
@tls_option
@http_options
@verbose_option
def start(**options: Any) -> int:
    """Validate and store the episodes of workers for a coordinator.

    The coordinator keeps the ledger and assigns the jobs; episodes are not sent to it. The gateway runs until it is
    stopped. When the run has finished, copy the episodes of all gateways into one dataset with `factory gather`.
    """
    from factory.commands.farm.gateway import start

    return start(**options)
