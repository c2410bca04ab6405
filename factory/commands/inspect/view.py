"""`factory view`: shows one episode in the Rerun viewer."""

from __future__ import annotations

from pathlib import Path

import click

from factory.commands.common.bars import Bars
from factory.commands.common.episode_names import episode_index
from factory.commands.common.output import print_json
from factory.dataset.reader import Dataset
from factory.runs.scene_packages import find_package
from factory.visualize.rerun import view_episode
from schemas.errors import UsageError
from schemas.job import episode_id
from schemas.scene import read_geometry
from schemas.storage.place import Place
from schemas.support.extras import require_package


def execute(root: Place, episode: str, out: Path | None, stride: int, as_json: bool) -> None:
    """Executes `factory view`."""
    require_package("rerun", "factory view")
    dataset = Dataset(root)
    try:
        chosen = dataset[episode_id(episode_index(episode))]
    except KeyError as error:
        raise UsageError(f"{error.args[0]}; see `factory jobs list {root}`") from error
    job = chosen.meta.job
    scene = read_geometry(find_package(root, job.scene, job.scene_sha256).path)
    frames = range(0, len(chosen), stride)
    with chosen, Bars() as progress:
        task = progress.add_task("frames", total=len(frames))
        view_episode(chosen, scene, out, stride, lambda _: progress.advance(task))
    if as_json:
        shown = {"episode": chosen.episode_id, "file": str(out) if out else None, "steps": len(chosen)}
        print_json(shown | {"frames": len(frames)})
    else:
        where = str(out) if out else "the viewer"
        click.echo(f"{chosen.episode_id}: {len(frames)} of {len(chosen)} frames in {where}")
