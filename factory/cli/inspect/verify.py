"""`factory verify`: checks the hashes, shapes, bounds and kinematics of a dataset."""

from __future__ import annotations

import os
from typing import Any

import click

from factory.cli.common.bars import one_bar
from factory.cli.common.options import place_argument, workers_option
from factory.cli.common.output import json_option, print_json
from factory.support.logs import configure_logs
from factory.verify.dataset import VerifyReport, verify
from schemas.storage.place import Place


@click.command("verify")
@place_argument
@click.option(
    "--deep", is_flag=True, help="Also decode every frame and recompute digests, statistics and kinematics. Slow."
)
@workers_option("Number of processes, used with --deep")
@json_option
def command(root: Place, deep: bool, workers: int | None, as_json: bool) -> int:
    """Check the files, tables and hashes of a dataset.

    Exits with 1 if anything is damaged.
    """
    configure_logs()
    with one_bar("verifying") as tell:
        report = verify(root, deep, tell, (workers or os.cpu_count() or 1) if deep else 1)
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
        "digest": report.digest,
        "findings": [{"kind": f.kind, "file": f.file, "text": f.text} for f in report.findings],
    }


def _print(report: VerifyReport) -> None:
    for finding in report.findings:
        click.echo(f"{finding.kind}: {finding.file}: {finding.text}")
    how = "all bytes checked" if report.deep else "files and tables checked; --deep checks the content of episodes"
    verdict = "valid" if report.ok else f"{len(report.findings)} findings"
    state = "complete" if report.complete else "incomplete"
    click.echo(f"{report.root}: {verdict} ({how}); {report.episodes} episodes, {state}, digest {report.digest}")
