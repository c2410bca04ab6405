"""`factory report`: writes the figures of the paper for a dataset and one HTML page that works offline."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import click

from factory.cli.options import compare_option, json_option, place_argument, write_option

if TYPE_CHECKING:
    from schemas.storage.place import Place


@click.command("report")
@place_argument
@write_option("DIR", "Output folder. An existing report is replaced.", required=True)
@click.option("--force", is_flag=True, help="Allow a folder that contains other files; they are kept.")
@compare_option
@json_option
def command(root: Place, out: Path, force: bool, compare_paper: bool | None, as_json: bool) -> int:
    """Write an HTML report with figures of a dataset.

    Writes report.html and figures/ to --out; the page works offline. Exits with 1 if damaged episodes were skipped; the
    page lists them.
    """
    from factory.report import make_report  # imports matplotlib, which is slow and may be missing
    from factory.support.logs import configure_logs
    from factory.support.terminal import Bars, print_json

    configure_logs()
    with Bars() as bar:
        tasks = {what: bar.add_task(what, total=None) for what in ("episodes", "figures")}
        summary = make_report(
            root,
            out,
            force,
            on_progress=lambda what, done, total: bar.update(tasks[what], completed=done, total=total),
            compare_paper=compare_paper,
        )
    if as_json:
        print_json({"page": str(out / "report.html"), **summary.model_dump(mode="json")})
    else:
        figures = sum(name.endswith(".svg") for name in summary.files)
        click.echo(f"{out / 'report.html'}: {summary.episodes} of {summary.planned} episodes, {figures} figures")
    for remark in summary.remarks:
        click.echo(f"{'damage' if remark.is_damage else 'note'}: {remark.file}: {remark.text}", err=True)
    return 1 if any(remark.is_damage for remark in summary.remarks) else 0
