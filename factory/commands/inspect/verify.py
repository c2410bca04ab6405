"""`factory verify`: checks the hashes, shapes, bounds and kinematics of a dataset."""

from __future__ import annotations

from typing import Any

import click

from factory.commands.common.bars import one_bar
from factory.commands.common.output import print_json, print_table
from factory.support.logs import configure_logs
from factory.verify.dataset import VerifyReport, verify
from factory.verify.rendering import RenderDifference
from schemas.storage.place import Place


def execute(root: Place, deep: bool, render: int, reference: Place | None, workers: int | None, as_json: bool) -> int:
    """Executes `factory verify`."""
    configure_logs()
    processes = workers if deep or render else 1
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
