"""Declares `factory stats`: arguments, options and help."""

from __future__ import annotations

from typing import Any

import click

from factory.cli.common.options import compare_option, json_option, place_argument


@click.command("stats")
@place_argument
@click.option(
    "--language",
    is_flag=True,
    help="Print how often the target can be found without language, how many objects the instructions fit, and how "
    "often the target is in view at the end. Reads two frames of each episode, for at most 2000 episodes.",
)
@compare_option
@json_option
def command(**options: Any) -> int:
    """Print the statistics of a dataset.

    Exits with 1 if damaged episodes were skipped.
    """
    from factory.commands.inspect.stats import execute

    return execute(**options)
