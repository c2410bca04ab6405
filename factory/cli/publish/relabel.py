"""`factory relabel`: writes new verified instructions for an existing dataset, without driving."""

from __future__ import annotations

import os
from pathlib import Path

import click

from factory.cli.common.bars import one_bar
from factory.cli.common.options import dataset_argument, workers_option, write_option
from factory.cli.common.output import json_option, print_result, print_table
from factory.relabel.run import RelabelReport, relabel
from factory.support.logs import configure_logs
from schemas.language.file import load_language
from workers.client.stopping import stop_on_signals


@click.command("relabel")
@dataset_argument
@write_option("DIR", "Directory of the new dataset. An interrupted call is continued.", required=True)
@click.option(
    "--language",
    "reference",
    required=True,
    metavar="FILE",
    help="Language file (TOML): languages, registers and features of the instructions (docs/language.md).",
)
@workers_option("Number of processes")
@json_option
def command(root: Path, out: Path, reference: str, workers: int | None, as_json: bool) -> int:
    """Write new verified instructions for a dataset.

    The new dataset has hard links to the episodes of DIR, and one or more new instructions for each. A verifier reads
    every instruction, and accepts it only if it fits the target and no other object. An episode without such an
    instruction keeps the recorded one. After Ctrl-C or a crash, the same command continues.
    """
    configure_logs()
    spec = load_language(reference)
    with stop_on_signals() as (stop, _), one_bar("episodes") as tell:
        report = relabel(root, out, spec, os.cpu_count() or 1 if workers is None else workers, tell, stop)
    if not report.finished:
        click.echo(
            f"interrupted after about {report.episodes} episodes; run the same command again to continue", err=True
        )
        return 130
    print_result(report, as_json, _print)
    return 0


def _print(report: RelabelReport) -> None:
    click.echo(f"{report.out}: {report.instructions} instructions for {report.episodes} episodes")
    if report.recorded:
        click.echo(f"{report.recorded} episodes keep their recorded instruction: no new one fits their target only")
    numbers = (
        ("distinct sentences", report.distinct),
        ("sentence patterns", report.patterns),
        ("minimal expressions", report.minimal),
        ("routes", report.routes),
        ("false premises", report.false_premises),
        ("questions", report.questions),
        ("rejected by the verifier", sum(report.rejected.values())),
    )
    print_table("", ("measure", "number"), numbers)
    print_table("Languages", ("language", "instructions"), report.languages.items())
    print_table("Features", ("feature", "instructions"), report.features.items())
