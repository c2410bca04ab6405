"""`factory view`: shows one episode in the Rerun viewer."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import click

from factory.cli.options import count_option, episode_argument, json_option, place_argument, write_option
from schemas.errors import UsageError
from schemas.support.extras import require_package
from schemas.support.shell import quoted

if TYPE_CHECKING:
    from schemas.storage.place import Place


@click.command("view")
@place_argument
@episode_argument
@write_option("FILE", "Write a Rerun recording (.rrd) to this file instead of opening the viewer.")
@count_option("--stride", 2, "Show every Nth frame.", most=1000)
@json_option
def command(root: Place, episode: str, out: Path | None, stride: int, as_json: bool) -> None:
    """Open one episode in the Rerun viewer.

    EPISODE is a name or number: ep_000001 or 1. Shows colour, depth and instance ids, the map with the robot and its
    trajectory, the actions and the instruction. Requires the extra `view`.
    """
    from factory.dataset.episode_names import episode_index
    from factory.dataset.reader import Dataset
    from factory.runs.scene_packages import find_package
    from factory.support.terminal import Bars, print_json
    from factory.visualize.rerun import view_episode
    from schemas.job import episode_id
    from schemas.scene import read_geometry

    require_package("rerun", "factory view")
    dataset = Dataset(root)
    try:
        chosen = dataset[episode_id(episode_index(episode))]
    except KeyError as error:
        raise UsageError(f"{error.args[0]}; see `factory jobs list {quoted(root)}`") from error
    job = chosen.meta.job
    scene = read_geometry(find_package(root, job.scene, job.scene_sha256).path)
    frames = range(0, len(chosen), stride)
    with chosen, Bars() as progress:
        task = progress.add_task("frames", total=len(frames))
        view_episode(chosen, scene, out, stride=stride, tell=lambda _: progress.advance(task))
    if as_json:
        shown = {"episode": chosen.episode_id, "file": str(out) if out else None, "steps": len(chosen)}
        print_json(shown | {"frames": len(frames)})
    else:
        where = str(out) if out else "the viewer"
        click.echo(f"{chosen.episode_id}: {len(frames)} of {len(chosen)} frames in {where}")
