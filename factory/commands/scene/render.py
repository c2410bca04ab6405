"""`factory scene render`: writes the map, views and contact sheets of a scene as images."""

from __future__ import annotations

from pathlib import Path

import click

from factory.commands.common.output import print_json, stderr
from factory.commands.scene.choice import chosen_scene
from factory.support.logs import configure_logs
from schemas.storage.disk import translated
from schemas.terms import RendererKind


def execute(
    scene: str,
    seed: int,
    out: Path | None,
    views: int,
    robot_views: int,
    colours: int,
    renderer: RendererKind,
    as_json: bool,
) -> None:
    """Executes `factory scene render`."""
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
