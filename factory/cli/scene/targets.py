"""Declares `factory scene targets`: arguments, options and help."""

from __future__ import annotations

from typing import Any

import click

from factory.cli.common.options import json_option, write_option
from factory.cli.scene.choice import scene_argument, seed_option


@click.command("targets")
@scene_argument
@seed_option
@write_option("FILE", "Output file; - prints to stdout. Default: targets_SCENE.yaml.")
@click.option("--force", is_flag=True, help="Replace an existing file.")
@json_option
def command(**options: Any) -> None:
    """Write the targets of a scene to a YAML file for editing.

    SCENE is the name of a scene; PACKAGE is a scene package (*.scene.zip).
    Pass the edited file to `factory scene build` or `factory scene import` with --targets FILE.
    """
    from factory.commands.scene.targets import execute

    execute(**options)
