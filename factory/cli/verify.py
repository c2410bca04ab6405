"""`factory verify`: checks the hashes, shapes, bounds and kinematics of a dataset."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import click

from factory.cli.options import PLACE, json_option, place_argument, workers_option

if TYPE_CHECKING:
    from schemas.storage.place import Place


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
def command(root: Place, deep: bool, render: int, reference: Place | None, workers: int | None, as_json: bool) -> int:
    """Check the files, tables and hashes of a dataset.

    Exits with 1 if anything is damaged.
    """
    from factory.support.logs import configure_logs
    from factory.support.terminal import one_bar, print_json
    from factory.verify.dataset import verify
    from factory.verify.findings import print_report

    configure_logs()
    processes = workers if deep or render else 1
    with one_bar("verifying") as on_progress:
        report = verify(root, deep, on_progress, processes=processes, render=render, reference=reference)
    if as_json:
        print_json(report.plain())
    else:
        print_report(report)
    return 0 if report.ok else 1
