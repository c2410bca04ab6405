"""Declares `factory verify`: arguments, options and help."""

from __future__ import annotations

from typing import Any

import click

from factory.cli.common.options import json_option, place_argument, workers_option
from factory.cli.common.places import PLACE


class _EpisodeCount(click.ParamType):  # type: ignore[type-arg]  # generic since click 8.5 only
    """Number of episodes, or `all`."""

    name = "count"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> int:
        """Returns the number; `all` becomes the largest number of episodes that a plan can have."""
        if value == "all":
            from schemas.plan import MAX_EPISODES

            return MAX_EPISODES
        return int(click.IntRange(min=0).convert(value, param, ctx))


@click.command("verify")
@place_argument
@click.option(
    "--deep", is_flag=True, help="Also decode every frame and recompute digests, statistics and kinematics. Slow."
)
@click.option(
    "--render",
    type=_EpisodeCount(),
    default=0,
    metavar="all|N",
    help="Render frames of all or N episodes again and compare them with the recorded digests. Default: no episode.",
)
@click.option(
    "--reference",
    type=PLACE,
    metavar="DIR|URL",
    help="Dataset that stores frames of the same episodes. With --render of a dataset of states: print how far "
    "rendered pixels differ from these frames.",
)
@workers_option(
    "Number of processes, used with --deep and --render",
    unset="one per core, or fewer if starting them takes longer than the checks",
)
@json_option
def command(**options: Any) -> int:
    """Check the files, tables and hashes of a dataset.

    Exits with 1 if anything is damaged.
    """
    from factory.commands.inspect.verify import execute

    return execute(**options)
