"""`factory relabel`: writes new verified instructions for an existing dataset, without driving."""

from __future__ import annotations

from pathlib import Path

import click

from coordinator.defaults import usable_cores
from factory.cli.options import dataset_argument, json_option, workers_option, write_option
from schemas.errors import UsageError


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
@click.option("--paraphrase", "url", metavar="URL", help="OpenAI-compatible endpoint that rewrites sentence patterns.")
@click.option("--model", metavar="NAME", help="Model of the endpoint.")
@click.option(
    "--paraphrase-cache",
    "cache",
    type=click.Path(dir_okay=False, path_type=Path),
    metavar="FILE",
    help="File that caches the answers of the endpoint. Default: the path of the language file plus .paraphrases.json.",
)
@click.option(
    "--paraphrase-timeout",
    "timeout_s",
    type=click.FloatRange(0.1, 3600.0),
    default=60.0,
    metavar="SECONDS",
    show_default=True,
    help="Timeout of a request to the endpoint, seconds.",
)
@workers_option("Number of processes")
@json_option
def command(
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
    """Write new verified instructions for a dataset.

    The new dataset has hard links to the episodes of DIR, and one or more new instructions for each. A verifier reads
    every instruction, and accepts it only if it fits the target and no other object. An episode without such an
    instruction keeps the recorded one. After Ctrl-C or a crash, the same command continues.

    With --paraphrase, an endpoint rewrites the sentence patterns once. Unusable patterns, and requests
    without an answer, are omitted and counted. The API key is read from MINIVLA_PARAPHRASE_KEY.
    """
    from factory.relabel.paraphrase import Endpoint, with_paraphrases
    from factory.relabel.relabel_dataset import print_report, recorded_paraphrases, relabel
    from factory.support.logs import configure_logs
    from factory.support.terminal import one_bar, print_result
    from schemas.language.language_file import load_language
    from workers.client.stopping import stop_on_signals

    configure_logs()
    spec, paraphrases = load_language(reference), None
    if (url is None) != (model is None):
        raise UsageError("--paraphrase URL and --model NAME must be given together")
    if url is not None and model is not None:
        kept = recorded_paraphrases(out, spec)
        file = cache or Path(f"{reference}.paraphrases.json")
        spec, paraphrases = (kept, None) if kept else with_paraphrases(spec, Endpoint(url, model, timeout_s), file)
    with stop_on_signals() as (stop, _), one_bar("episodes") as on_progress:
        report = relabel(root, out, spec, workers=workers or usable_cores(), on_progress=on_progress, stop=stop)
    if not report.finished:
        click.echo(
            f"interrupted after about {report.episodes} episodes; run the same command again to continue", err=True
        )
        return 130
    print_result(report.model_copy(update={"paraphrases": paraphrases}), as_json, print_report)
    return 0
