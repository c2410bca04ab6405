"""Declares `factory relabel`: arguments, options and help."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from factory.cli.common.options import dataset_argument, json_option, workers_option, write_option


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
def command(**options: Any) -> int:
    """Write new verified instructions for a dataset.

    The new dataset has hard links to the episodes of DIR, and one or more new instructions for each. A verifier reads
    every instruction, and accepts it only if it fits the target and no other object. An episode without such an
    instruction keeps the recorded one. After Ctrl-C or a crash, the same command continues.

    With --paraphrase, an endpoint rewrites the sentence patterns once. Unusable patterns, and requests
    without an answer, are omitted and counted. The API key is read from MINIVLA_PARAPHRASE_KEY.
    """
    from factory.commands.publish.relabel import execute

    return execute(**options)
