"""`factory merge`: merges datasets, also of different plans, into a new one."""

from __future__ import annotations

from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING

import click

from factory.cli.options import PLACE, json_option, write_option
from schemas.support.shell import quoted

if TYPE_CHECKING:
    from factory.merge.merge import MergeReport
    from schemas.storage.place import Place


@click.command("merge")
@click.argument("sources", metavar="DIR|URL...", nargs=-1, required=True, type=PLACE)
@write_option("DIR", "Directory of the merged dataset, which must not exist.", required=True, file_okay=False)
@click.option(
    "--link",
    "is_linked",
    is_flag=True,
    help="Make hard links to the episodes instead of copies; they need no space. Packed episodes are copied.",
)
@click.option("--partial", "is_partial", is_flag=True, help="Also merge datasets that lack planned episodes.")
@json_option
def command(sources: tuple[Place, ...], out: Path, is_linked: bool, is_partial: bool, as_json: bool) -> None:
    """Merge datasets, also of different plans, into a new one.

    The datasets must store the same kind of episode (frames or states) with the same
    task, robot, camera, rig and appearance. Episodes keep their bytes and get consecutive numbers; the columns `source`
    and `source_episode` of metadata.parquet name their origin. The result is verified and appears only when it is
    complete. After an interruption, the same command continues. The datasets are not changed.
    """
    from factory.merge.merge import merge, open_parts
    from factory.support.logs import configure_logs
    from factory.support.terminal import one_bar, print_result

    configure_logs()
    parts = open_parts(sources, is_partial=is_partial)
    with one_bar("merging") as on_progress:
        report = merge(parts, out, datetime.now(UTC), is_linked=is_linked, on_progress=on_progress)
    print_result(report, as_json, _print)


def _print(report: MergeReport) -> None:
    from factory.support.terminal import print_table
    from factory.support.text import format_bytes

    rows = [(each.name, each.run, each.episodes, f"{each.numbers[0]}-{each.numbers[-1]}") for each in report.sources]
    print_table("", ("source", "run", "episodes", "numbers"), rows)
    how = "linked" if report.linked else "copied"
    click.echo(
        f"{report.dataset}: {report.episodes} of {report.planned} episodes {how}, {format_bytes(report.bytes)}; "
        "verified"
    )
    click.echo(f"digest  {report.digest or '- (incomplete)'}")
    click.echo(f"next:    factory stats {quoted(report.dataset)}")
