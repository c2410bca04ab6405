"""Declares `factory push`: arguments, options and help."""

from __future__ import annotations

from typing import Any

import click

from factory.cli.common.options import dataset_argument, json_option


@click.command("push")
@dataset_argument
@click.argument("repository", metavar="OWNER/NAME")
@click.option("--private", is_flag=True, help="If the repository does not exist, create it as private.")
@click.option("--endpoint", metavar="URL", help="URL of the Hub. Default: HF_ENDPOINT, else https://huggingface.co.")
@click.option(
    "--thumbnails",
    is_flag=True,
    help="Render the missing thumbnails of a dataset of states into its tables, for the Hub's viewer. Needs the extra "
    "`render`.",
)
@click.option("--dry-run", is_flag=True, help="Print what would be uploaded, without network access.")
@json_option
def command(**options: Any) -> None:
    """Upload a dataset or an export to the Hugging Face Hub.

    DIR is a dataset or the output of `factory export`. OWNER/NAME is a dataset repository.
    Log in with `hf auth login`, or set HF_TOKEN to a token with write access.
    The same command continues an interrupted upload.
    """
    from factory.commands.publish.push import execute

    execute(**options)
