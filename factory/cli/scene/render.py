"""`factory scene render`: writes the map, views and contact sheets of a scene as images."""

from __future__ import annotations

from pathlib import Path

import click

from factory.cli.common.options import count_option, renderer_option, write_option
from factory.cli.common.output import json_option, print_json, stderr
from factory.cli.scene.choice import chosen_scene, scene_argument, seed_option
from factory.support.logs import configure_logs
from schemas.storage.disk import translated
from schemas.terms import RendererKind


@click.command("render")
@scene_argument
@seed_option
@write_option("DIR", "Output folder of the images. Default: ./SCENE.")
@count_option("--views", 6, "Number of views from 1.5 m above the floor.", least=0, most=64)
@count_option("--robot-views", 4, "Number of views from the robot's camera.", least=0, most=64)
@count_option("--colours", 0, "Number of targets to show with their colour names.", least=0, most=500)
@renderer_option
@json_option
def command(
    scene: str,
    seed: int,
    out: Path | None,
    views: int,
    robot_views: int,
    colours: int,
    renderer: RendererKind,
    as_json: bool,
) -> None:
    """Render the map, views and contact sheets of a scene.

    SCENE is the name of a scene; PACKAGE is a scene package (*.scene.zip).
    """
    from factory.scenes.pictures import Wanted, draw_scene

    configure_logs()
    compiled = chosen_scene(scene, seed)
    folder = out or Path(compiled.info.name)
    wanted = Wanted(views, robot_views, colours)
    with translated("write to", folder), stderr.status(f"rendering {compiled.info.name}"):
        paths = [str(path) for path in draw_scene(compiled, folder, wanted, renderer)]
    if as_json:
        print_json({"scene": compiled.info.name, "pictures": paths})
    else:
        for written in paths:
            click.echo(written)
