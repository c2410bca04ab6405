"""`factory verify`: checks the hashes, shapes, bounds and kinematics of a dataset."""

from __future__ import annotations

import os
from typing import Any

import click

from factory.cli.common.bars import one_bar
from factory.cli.common.options import place_argument, workers_option
from factory.cli.common.output import json_option, print_json, print_table
from factory.cli.common.places import PLACE
from factory.support.logs import configure_logs
from factory.verify.dataset import VerifyReport, verify
from factory.verify.difference import RenderDifference
from schemas.plan import MAX_EPISODES
from schemas.storage.place import Place


class _EpisodeCount(click.ParamType):  # type: ignore[type-arg]  # generic since click 8.5 only
    """Number of episodes, or `all`."""

    name = "count"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> int:
        """Returns the number; `all` is the largest one."""
        if value == "all":
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
@workers_option("Number of processes, used with --deep and --render")
@json_option
def command(root: Place, deep: bool, render: int, reference: Place | None, workers: int | None, as_json: bool) -> int:
    """Check the files, tables and hashes of a dataset.

    Exits with 1 if anything is damaged.
    """
    configure_logs()
    processes = (workers or os.cpu_count() or 1) if deep or render else 1
    with one_bar("verifying") as tell:
        report = verify(root, deep, tell, processes, render, reference)
    if as_json:
        print_json(_plain(report))
    else:
        _print(report)
    return 0 if report.ok else 1


def _plain(report: VerifyReport) -> dict[str, Any]:
    return {
        "dataset": str(report.root),
        "deep": report.deep,
        "ok": report.ok,
        "complete": report.complete,
        "episodes": report.episodes,
        "rendered": report.rendered,
        "digest": report.digest,
        "difference": report.difference.plain() if report.rendered else None,
        "findings": [{"kind": f.kind, "file": f.file, "text": f.text} for f in report.findings],
    }


def _print(report: VerifyReport) -> None:
    for finding in report.findings:
        click.echo(f"{finding.kind}: {finding.file}: {finding.text}")
    if report.difference.differing:
        _print_difference(report.difference)
    how = "all bytes checked" if report.deep else "files and tables checked; --deep checks the content of episodes"
    how += f"; frames of {report.rendered} episodes rendered again" if report.rendered else ""
    verdict = "valid" if report.ok else f"{len(report.findings)} findings"
    state = "complete" if report.complete else "incomplete"
    click.echo(f"{report.root}: {verdict} ({how}); {report.episodes} episodes, {state}, digest {report.digest}")


def _print_difference(found: RenderDifference) -> None:
    click.echo(
        f"{found.differing} of {found.frames} rendered frames differ; recorded with "
        f"{' and '.join(sorted(found.recorded_with))}; rendered with {' and '.join(sorted(found.rendered_with))}"
    )
    plain = found.plain()["channels"]
    if plain is None:
        click.echo("the recorded pixels are not stored; --reference compares with a dataset that stores them")
        return
    rows = [
        (name, 100 * values["share"], *(values.get(key) for key in ("mean", "largest")))
        for name, values in plain.items()
    ]
    columns = ("channel", "differing values, %", "mean difference", "largest")
    print_table(f"{found.measured} frames compared; colours in levels of 255, depth in metres", columns, rows)
