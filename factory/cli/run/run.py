"""Declares `factory run`: arguments, options and help."""

from __future__ import annotations

from typing import Any

import click

from factory.cli.common.gating import gate_option
from factory.cli.common.http import run_http_options
from factory.cli.common.options import (
    json_option,
    ledger_option,
    out_option,
    plan_argument,
    renderer_option,
    shrink_options,
    verbose_option,
    workers_option,
)
from factory.cli.common.places import PLACE, SHARD


@click.command("run")
@plan_argument(default=None)
@out_option
@workers_option("Number of simulation processes")
@renderer_option
@gate_option("auto")
@click.option(
    "--shard",
    type=SHARD,
    metavar="NUMBER/COUNT",
    help="Generate one of COUNT parts of the run, without a network connection to the others; `factory gather` joins "
    "them. No gate unless --gate requests it. Default: the shard that --out contains, or the whole run.",
)
@click.option(
    "--scenes",
    "packages",
    type=PLACE,
    metavar="DIR|URL",
    help="Folder with the compiled package of every scene, e.g. `scenes` of a dataset. Default: the packages in --out, "
    "or new ones.",
)
@click.option(
    "--engine",
    type=click.Choice(("local", "ray")),
    default="local",
    show_default=True,
    help="Where the simulations run. local: this machine; ray: every node of a Ray cluster, on all CPUs of a node or "
    "at most --workers of them.",
)
@click.option(
    "--address", metavar="ADDRESS", help="Address of the Ray cluster. Default: RAY_ADDRESS, or a new local one."
)
@ledger_option
@shrink_options
@run_http_options
@json_option
@verbose_option
def command(**options: Any) -> int:
    """Generate a dataset from a plan, or continue an interrupted run.

    PLAN is a built-in plan (demo, paper, balanced, referring) or a TOML file; default: the plan of the dataset in
    --out, or demo. After Ctrl-C, SIGTERM or a crash, the same command continues the run; finished episodes are
    kept. Exits with 1 if episodes are missing at the end.
    """
    from factory.commands.run.run import execute

    return execute(**options)
