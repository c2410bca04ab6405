"""`factory relabel`: writes new verified instructions for an existing dataset, without driving."""

from __future__ import annotations

import os
from pathlib import Path

import click

from factory.commands.common.bars import one_bar
from factory.commands.common.output import print_result, print_table
from factory.relabel.paraphrase import Endpoint, ParaphraseReport, with_paraphrases
from factory.relabel.relabel_dataset import RelabelReport, recorded_paraphrases, relabel
from factory.support.logs import configure_logs
from schemas.errors import UsageError
from schemas.language.language_file import load_language
from workers.client.stopping import stop_on_signals


def execute(
    root: Path,
    out: Path,
    reference: str,
    url: str | None,
    model: str | None,
    cache: Path | None,
    timeout_s: float,
    workers: int | None,
    as_json: bool,
) -> int:
    """Executes `factory relabel`."""
    configure_logs()
    spec, paraphrases = load_language(reference), None
    if (url is None) != (model is None):
        raise UsageError("--paraphrase URL and --model NAME must be given together")
    if url is not None and model is not None:
        kept = recorded_paraphrases(out, spec)
        file = cache or Path(f"{reference}.paraphrases.json")
        spec, paraphrases = (kept, None) if kept else with_paraphrases(spec, Endpoint(url, model, timeout_s), file)
    with stop_on_signals() as (stop, _), one_bar("episodes") as tell:
        report = relabel(root, out, spec, os.cpu_count() or 1 if workers is None else workers, tell, stop)
    if not report.finished:
        click.echo(
            f"interrupted after about {report.episodes} episodes; run the same command again to continue", err=True
        )
        return 130
    print_result(report.model_copy(update={"paraphrases": paraphrases}), as_json, _print)
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
    if report.paraphrases is not None:
        _print_paraphrases(report.paraphrases)
    print_table("Languages", ("language", "instructions"), report.languages.items())
    print_table("Features", ("feature", "instructions"), report.features.items())


def _print_paraphrases(found: ParaphraseReport) -> None:
    click.echo(f"{found.accepted} paraphrased sentence patterns")
    omitted = [*found.refused.items(), *((f"endpoint: {reason}", count) for reason, count in found.failed.items())]
    if omitted:
        print_table("Paraphrases that were not added", ("reason", "number"), omitted)
