"""Declares `factory coordinator start`: arguments, options and help."""

from __future__ import annotations

from typing import Any

import click

from coordinator.defaults import LEASE_TTL_S
from factory.cli.common.gating import gate_option
from factory.cli.common.groups import CommandGroup
from factory.cli.common.http import run_http_options
from factory.cli.common.options import (
    ledger_option,
    listen_option,
    number_option,
    out_option,
    plan_argument,
    pullers_option,
    shrink_options,
    tls_option,
    verbose_option,
)
from factory.cli.common.places import PLACE


@click.group("coordinator", cls=CommandGroup)
def command() -> None:
    """Start the coordinator of a run whose workers are on other hosts."""


@command.command("start")
@plan_argument(default=None)
@out_option
@listen_option(
    "Endpoint to listen on for workers, repeatable; port 0 selects a free port. Default: tcp/127.0.0.1:7447; with "
    "--tls: tls/0.0.0.0:7447."
)
@ledger_option
@number_option(
    "SECONDS",
    "--lease",
    LEASE_TTL_S,
    "Lease time of a job, seconds. A worker that sends no heartbeat for this time loses its job.",
    "lease_ttl_s",
    least=1.0,
)
@pullers_option()
@click.option(
    "--spot-checks",
    type=click.FloatRange(0.0, 1.0),
    metavar="SHARE",
    help="Let the workers validate their bundles, and validate this share of them again, e.g. 0.05. A host whose "
    "bundle then fails is barred. Default: validate all bundles here.",
)
@click.option("--stay", is_flag=True, help="Do not exit when the run has finished; keep answering requests.")
@tls_option
@run_http_options
@gate_option("skip")
@click.option(
    "--states",
    type=PLACE,
    metavar="DIR|URL",
    help="Let the workers render the frames of this states dataset, instead of running PLAN. Default: run PLAN.",
)
@shrink_options
@verbose_option
def start(**options: Any) -> int:
    """Assign the jobs of a plan to workers and archive their episodes.

    PLAN is a built-in plan (demo, paper, balanced, referring) or a TOML file; default: the plan of the dataset in
    --out, or demo. Exits when the run has finished: with 0, or with 1 if episodes are missing. Exits with 0 if it
    is stopped earlier. The gate (--gate) runs on this host before the first job is assigned.
    """
    from factory.commands.farm.coordinator import start

    return start(**options)
