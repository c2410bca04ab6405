"""Declares `factory gather`: arguments, options and help."""

from __future__ import annotations

from typing import Any

import click

from factory.cli.common.options import json_option, ledger_option, shrink_options
from factory.cli.common.places import PLACE, SITE


@click.command("gather")
@click.argument("first", metavar="DIR|PLAN")
@click.argument("sources", metavar="[GATEWAY_DIR|SHARD]...", nargs=-1, type=PLACE)
@click.option(
    "-o",
    "--out",
    "site",
    metavar="DIR|URL",
    type=SITE,
    help="Join the shards of PLAN into this dataset. Default: gather the episodes of gateways into DIR.",
)
@click.option(
    "--requeue-missing",
    is_flag=True,
    help="Requeue episodes that are in none of the directories; they are generated again with the same content. With "
    "--out, shards may be missing or unfinished.",
)
@ledger_option
@shrink_options
@json_option
def command(**options: Any) -> int:
    """Copy the episodes of gateways or shards into one dataset.

    Gateways: DIR is the coordinator's dataset directory; stop its coordinator first. GATEWAY_DIR is the --out of a
    gateway, or a copy of it; it is not changed. Each episode is checked against the ledger. If you give only some of
    the gateways' directories, run the command again with the others.

    Shards: `factory gather PLAN SHARD... --out DIR|URL` with PLAN and its options as in `factory run --shard`. SHARD is
    the --out of a shard, or a folder that contains several; it is not changed. The dataset has the digest that
    a run without shards gives.

    Exits with 1 if episodes are missing and not requeued.
    """
    from factory.commands.farm.gather import execute

    return execute(**options)
