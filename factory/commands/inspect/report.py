"""`factory report`: writes the figures of the paper for a dataset and one HTML page that works offline."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import click

from factory.commands.common.bars import Bars
from factory.commands.common.output import print_json
from factory.support.logs import configure_logs
from schemas.storage.place import Place

if TYPE_CHECKING:
    from factory.report import Summary


def execute(root: Place, out: Path, force: bool, compare_paper: bool | None, as_json: bool) -> int:
    """Executes `factory report`."""
    configure_logs()
    summary = _make(root, out, force, compare_paper)
    if as_json:
        print_json({"page": str(out / "report.html"), **summary.model_dump(mode="json")})
    else:
        figures = sum(name.endswith(".svg") for name in summary.files)
        click.echo(f"{out / 'report.html'}: {summary.episodes} of {summary.planned} episodes, {figures} figures")
    for remark in summary.remarks:
        click.echo(f"{'damage' if remark.is_damage else 'note'}: {remark.file}: {remark.text}", err=True)
    return 1 if any(remark.is_damage for remark in summary.remarks) else 0


def _make(root: Place, out: Path, force: bool, compare_paper: bool | None) -> Summary:
    from factory.report import make_report  # imports matplotlib, which is slow and may be missing

    with Bars() as bar:
        tasks = {what: bar.add_task(what, total=None) for what in ("episodes", "figures")}
        return make_report(
            root,
            out,
            force,
            lambda what, done, total: bar.update(tasks[what], completed=done, total=total),
            compare_paper,
        )
