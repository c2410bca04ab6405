"""`factory scene targets`: writes the list of a scene's targets for editing."""

from __future__ import annotations

from pathlib import Path

import click

from factory.commands.common.output import print_json
from factory.commands.scene.choice import chosen_scene
from schemas.errors import UsageError
from schemas.storage.disk import translated


def execute(scene: str, seed: int, out: Path | None, force: bool, as_json: bool) -> None:
    """Executes `factory scene targets`."""
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
