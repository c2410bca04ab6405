"""Declares `factory scene inspect`: arguments, options and help."""

from __future__ import annotations

from typing import Any

import click

from factory.cli.common.options import json_option, write_option
from factory.cli.scene.choice import scene_argument, seed_option


@click.command("inspect")
@scene_argument
@seed_option
@write_option("FILE", "Also write a map with targets and start points to this PNG file.")
@json_option
def command(**options: Any) -> None:
    """Print the categories, targets and extents of a scene.

    SCENE is the name of a scene; PACKAGE is a scene package (*.scene.zip).
    """
    from factory.commands.scene.inspect import execute

    execute(**options)
