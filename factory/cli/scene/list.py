"""Declares `factory scene list`: arguments, options and help."""

from __future__ import annotations

from typing import Any

import click

from factory.cli.common.options import json_option
from factory.cli.common.places import PLACE


@click.command("list")
@click.argument("place", metavar="[DIR|URL]", type=PLACE, required=False)
@json_option
def command(**options: Any) -> None:
    """List built-in and imported scenes, or those of a dataset.

    DIR|URL is a dataset, whose layouts are listed by family with the seed of each.
    """
    from factory.commands.scene.list import execute

    execute(**options)
