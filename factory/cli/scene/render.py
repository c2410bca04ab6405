"""Declares `factory scene render`: arguments, options and help."""

from __future__ import annotations

from typing import Any

import click

from factory.cli.common.options import count_option, json_option, renderer_option, write_option
from factory.cli.scene.choice import scene_argument, seed_option


@click.command("render")
@scene_argument
@seed_option
@write_option("DIR", "Output folder of the images. Default: ./SCENE.")
@count_option("--views", 6, "Number of views from 1.5 m above the floor.", least=0, most=64)
@count_option("--robot-views", 4, "Number of views from the robot's camera.", least=0, most=64)
@count_option("--colours", 0, "Number of targets to show with their colour names.", least=0, most=500)
@renderer_option
@json_option
def command(**options: Any) -> None:
    """Render the map, views and contact sheets of a scene.

    SCENE is the name of a scene; PACKAGE is a scene package (*.scene.zip).
    """
    from factory.commands.scene.render import execute

    execute(**options)
