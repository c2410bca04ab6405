"""`factory scene light`: computes the light groups of a scene, which varied light needs."""

from __future__ import annotations

import click

from factory.commands.common.output import print_json, print_table, stderr
from factory.commands.scene.choice import scene_package
from factory.dataset.packages import light_file
from factory.support.logs import configure_logs
from schemas.appearance.light_groups import decode_light_groups
from schemas.storage.place import digest_of


def execute(scene: str, seed: int, as_json: bool) -> None:
    """Executes `factory scene light`."""
    configure_logs()
    package = scene_package(scene, seed)
    with stderr.status(f"light groups of {scene}"):
        path = light_file(package, digest_of(package))
    with path.open("rb") as file:
        groups = decode_light_groups(file).info.groups
    if as_json:
        print_json({"scene": scene, "file": str(path), "groups": [group.model_dump(mode="json") for group in groups]})
        return
    rows = [(group.kind, group.lamps, ", ".join(f"{value:.1f}" for value in group.centre_m)) for group in groups]
    print_table("", ("group", "lamps", "centre x, y, z in metres"), rows)
    click.echo(str(path))
