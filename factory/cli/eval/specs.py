"""Declares `factory eval specs`: arguments, options and help."""

from __future__ import annotations

from typing import Any

import click

from factory.cli.common.options import count_option, json_option, place_argument, write_option
from factory.cli.eval.splits import eval_split_filter


@click.command("specs")
@place_argument
@eval_split_filter
@click.option(
    "--unfiltered", is_flag=True, help="Sample new start states, including those where the expert would fail."
)
@count_option("--episodes", None, "Number of episodes. Default: all; with --unfiltered: 100.")
@count_option("--seed", 0, "Random seed of --unfiltered.", least=0)
@write_option("FILE", "JSON file to write.", required=True)
@json_option
def command(**options: Any) -> int:
    """Write the evaluation episodes of a dataset to a file.

    Evaluations with the same specs file use the same episodes.
    """
    from factory.commands.eval.specs import execute

    return execute(**options)
