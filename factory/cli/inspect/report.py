"""`factory report`: the paper's figures of a dataset and one HTML page that opens offline."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import click

from factory.cli.common.bars import Bars
from factory.cli.common.options import compare_option, place_argument
from factory.cli.common.output import json_option, print_json
from factory.support.logs import configure_logs
from schemas.storage.place import Place

if TYPE_CHECKING:
    from factory.report import Summary

__all__ = ["command"]


@click.command("report")
@place_argument
@click.option(
    "-o",
    "--out",
    required=True,
    metavar="DIR",
    type=click.Path(path_type=Path),
    help="Folder of the report. An earlier report there is replaced.",
)
@click.option("--force", is_flag=True, help="Also write into a folder that holds other files; these are kept.")
@compare_option
@json_option
def command(root: Place, out: Path, force: bool, compare_paper: bool | None, as_json: bool) -> int:
    """Draw the figures of a dataset and an HTML page.

    Writes --out/figures and --out/report.html, which needs no network. Exits with 1 when damaged episodes were left
    out; the page names them.
    """
    configure_logs()
    summary = _make(root, out, force, compare_paper)
    if as_json:
        print_json({"page": str(out / "report.html"), **summary.model_dump(mode="json")})
    else:
        figures = sum(name.endswith(".svg") for name in summary.files)
        click.echo(f"{out / 'report.html'}: {summary.episodes} of {summary.planned} episodes, {figures} drawings")
    for remark in summary.remarks:
        click.echo(f"{'damage' if remark.is_damage else 'note'}: {remark.file}: {remark.text}", err=True)
    return 1 if any(remark.is_damage for remark in summary.remarks) else 0


def _make(root: Place, out: Path, force: bool, compare_paper: bool | None) -> Summary:
    from factory.report import make_report  # matplotlib takes half a second and may be missing

    with Bars() as bar:
        tasks = {what: bar.add_task(what, total=None) for what in ("episodes", "figures")}
        return make_report(
            root,
            out,
            force,
            lambda what, done, total: bar.update(tasks[what], completed=done, total=total),
            compare_paper,
        )
