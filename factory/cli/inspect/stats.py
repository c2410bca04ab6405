"""`factory stats`: prints the tables of the paper for a dataset, optionally with the published values."""

from __future__ import annotations

import click

from factory.cli.common.options import compare_option, place_argument
from factory.cli.common.output import json_option, print_json
from factory.cli.inspect.stats_tables import print_statistics
from factory.stats import measure_dataset
from factory.support.logs import configure_logs
from schemas.storage.place import Place

__all__ = ["command"]


@click.command("stats")
@place_argument
@compare_option
@json_option
def command(root: Place, compare_paper: bool | None, as_json: bool) -> int:
    """Print the statistics of a dataset.

    Exits with 1 if damaged episodes were skipped.
    """
    configure_logs()
    statistics = measure_dataset(root, compare_paper)
    if as_json:
        print_json(statistics.model_dump(mode="json"))
    else:
        print_statistics(statistics)
    for remark in statistics.remarks:
        click.echo(f"{'damage' if remark.is_damage else 'note'}: {remark.file}: {remark.text}", err=True)
    return 0 if statistics.is_sound else 1
