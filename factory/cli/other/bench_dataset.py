"""Declares `factory bench dataset`: arguments, options and help."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from factory.cli.options import count_option, json_option


@click.command("dataset")
@count_option("--episodes", 20_000, "Number of episodes; each needs 16 kB of disk, ledger and tables included.")
@count_option("--reads", 2000, "Number of random episodes to read.")
@click.option(
    "-o",
    "--out",
    type=click.Path(path_type=Path, file_okay=False),
    metavar="DIR",
    help="New directory in which the dataset is kept. Default: the dataset is deleted.",
)
@json_option
def dataset(**options: Any) -> None:
    """Measure a large dataset of states.

    Generates a dataset from a few simulated episodes, then measures opening, filtering, random access, verification,
    status and checkpoints.
    """
    from factory.commands.other.bench_dataset import dataset

    dataset(**options)
