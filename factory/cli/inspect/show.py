"""Declares `factory show`: arguments, options and help."""

from __future__ import annotations

from typing import Any

import click

from factory.cli.common.options import count_option, json_option, place_argument, rig_option, write_option


@click.command("show")
@place_argument
@click.argument("episode")
@write_option("FILE", "Output file: .png, .mp4 or .gif. Default: EPISODE.png.", dir_okay=False)
@count_option("--columns", 6, "Number of frames per row of a contact sheet.", least=2, most=24)
@rig_option("Show the cameras and lidars of a rig, a row for each. Default: the recorded camera.")
@json_option
def command(**options: Any) -> None:
    """Write one episode as a contact sheet or a video.

    EPISODE is a name or number: ep_000001 or 1. A .png file is a contact sheet. An .mp4 or .gif file is a real-time
    video of colour, depth, instance ids and a map with the trajectory, with the instruction below. RIG is a built-in
    rig or a TOML file, see `factory rig list`. The sub-instructions of an episode with a route are printed with their
    frames.
    """
    from factory.commands.inspect.show import execute

    execute(**options)
