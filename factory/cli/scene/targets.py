"""`factory scene targets`: writes the list of a scene's targets for editing."""

from __future__ import annotations

from pathlib import Path

import click

from factory.cli.common.options import write_option
from factory.cli.common.output import json_option, print_json
from factory.cli.scene.choice import chosen_scene, scene_argument, seed_option
from schemas.errors import UsageError
from schemas.storage.disk import translated


@click.command("targets")
@scene_argument
@seed_option
@write_option("FILE", "Output file; - prints to stdout. Default: targets_SCENE.yaml.")
@click.option("--force", is_flag=True, help="Replace an existing file.")
@json_option
def command(scene: str, seed: int, out: Path | None, force: bool, as_json: bool) -> None:
    """Write the targets of a scene to a YAML file for editing.

    SCENE is the name of a scene; PACKAGE is a scene package (*.scene.zip).
    Pass the edited file to `factory scene build` or `factory scene import` with --targets FILE.
    """
    from factory.scenes.targets.target_list import format_target_list, list_file_name

    info = chosen_scene(scene, seed).info
    path = out or Path(list_file_name(info.name))
    if str(path) == "-":
        if as_json:
            raise UsageError("-o - and --json cannot be combined: remove --json, or give a file with -o")
        click.echo(format_target_list(info), nl=False)
        return
    if path.exists() and not force:
        raise UsageError(f"{path} exists and may contain your edits; replace it with --force")
    with translated("write", path):
        path.write_text(format_target_list(info), encoding="utf-8")
    if as_json:
        print_json({"file": str(path), "scene": info.name, "targets": len(info.targets)})
    else:
        click.echo(str(path))
