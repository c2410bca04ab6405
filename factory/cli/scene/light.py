"""Declares `factory scene light`: arguments, options and help."""

from __future__ import annotations

from typing import Any

import click

from factory.cli.common.options import json_option
from factory.cli.scene.choice import scene_argument, seed_option


@click.command("light")
@scene_argument
@seed_option
@json_option
def command(**options: Any) -> None:
    """Compute the light groups of a scene, and print them.

    SCENE is the name of a scene; PACKAGE is a scene package (*.scene.zip). The groups are kept in the cache; commands
    with --appearance compute them at the first use.
    """
    from factory.commands.scene.light import execute

    execute(**options)
