"""Declares `factory view`: arguments, options and help."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from factory.cli.common.options import count_option, former_option, json_option, place_argument, write_option


@click.command("view")
@place_argument
@click.argument("episode")
@write_option("FILE", "Write a Rerun recording (.rrd) to this file instead of opening the viewer.")
@former_option("--save", "out", "--out", type=click.Path(path_type=Path))
@count_option("--stride", 2, "Show every Nth frame.", most=1000)
@json_option
def command(**options: Any) -> None:
    """Open one episode in the Rerun viewer.

    EPISODE is a name or number: ep_000001 or 1. Shows colour, depth and instance ids, the map with the robot and its
    trajectory, the actions and the instruction. Requires the extra `view`.
    """
    from factory.commands.inspect.view import execute

    execute(**options)
