"""Declares `factory repair`: arguments, options and help."""

from __future__ import annotations

from typing import Any

import click

from factory.cli.common.options import json_option, ledger_option, site_argument


@click.command("repair")
@site_argument
@click.option("--dry-run", is_flag=True, help="Print the actions without executing them; exit with 1 if there are any.")
@click.option(
    "--plan",
    "plan_name",
    metavar="PLAN",
    help="Plan of the dataset, a built-in name or a TOML file. Required only if both the ledger and "
    "dataset_meta.json are lost.",
)
@click.option(
    "--take-over",
    is_flag=True,
    help="Take over a dataset in object storage from a coordinator that will not run again.",
)
@ledger_option
@json_option
def command(**options: Any) -> int:
    """Repair a damaged dataset, its ledger and its tables.

    Stop the coordinator of the dataset first. Every file is hashed. Valid episodes that are missing in the ledger are
    added to it. Invalid files are moved to quarantine/. Missing episodes are requeued; they are generated again with
    the same content. A lost or damaged ledger is rebuilt from the plan and the episodes. The tables are rewritten.
    """
    from factory.commands.inspect.repair import execute

    return execute(**options)
