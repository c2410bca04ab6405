"""Declares `factory pack`: arguments, options and help."""

from __future__ import annotations

from typing import Any

import click

from factory.cli.common.options import json_option, site_argument


@click.command("pack")
@site_argument
@json_option
def command(**options: Any) -> None:
    """Pack the episodes of a states dataset into shards.

    A shard is one file with the episodes of 1,000 consecutive numbers. Runs of more than 1,000 episodes pack
    automatically. Stop the coordinator of the dataset first. Files that differ from the tables remain as they are.
    """
    from factory.commands.inspect.pack import execute

    execute(**options)
