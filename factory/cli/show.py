"""`factory show`: a picture of one episode."""

from __future__ import annotations

from pathlib import Path

import click

from factory.catalog import find_package
from factory.cli.episodes import episode_path
from factory.cli.options import dataset_argument
from factory.contact_sheet import draw_contact_sheet
from schemas.bundle import BundleReader
from schemas.scene import decode_scene

__all__ = ["command"]


@click.command("show")
@dataset_argument
@click.argument("episode")
@click.option("-o", "--out", type=click.Path(path_type=Path), help="PNG to write; default EPISODE.png.")
@click.option("--columns", type=click.IntRange(2, 24), default=6, show_default=True, help="Frames across.")
def command(root: Path, episode: str, out: Path | None, columns: int) -> None:
    """Draw the contact sheet of EPISODE (`ep_000001` or a number) of the dataset DIR."""
    path = episode_path(root, episode)
    target = out or Path(f"{path.stem}.png")
    with path.open("rb") as file:
        bundle = BundleReader(file)
        job = bundle.meta.job
        with find_package(root, job.scene, job.scene_sha256).path.open("rb") as package:
            sheet = draw_contact_sheet(bundle, decode_scene(package), columns)
    target.parent.mkdir(parents=True, exist_ok=True)
    sheet.save(target)
    click.echo(str(target))
