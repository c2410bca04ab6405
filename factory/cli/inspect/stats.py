"""`factory stats`: prints the tables of the paper for a dataset, or statistics of its instructions and first frames."""

from __future__ import annotations

import click

from factory.cli.common.bars import Bars
from factory.cli.common.options import compare_option, place_argument
from factory.cli.common.output import json_option, print_json
from factory.cli.inspect.stats_tables import print_language, print_statistics
from factory.stats import LanguageStatistics, Statistics, measure_dataset
from factory.support.logs import configure_logs
from schemas.storage.place import Place

__all__ = ["command"]


@click.command("stats")
@place_argument
@click.option(
    "--language",
    is_flag=True,
    help="Print how often the target can be found without language, how many objects the instructions fit, and how "
    "often the target is in view at the end. Reads two frames of each episode, of 2000 episodes at most.",
)
@compare_option
@json_option
def command(root: Place, language: bool, compare_paper: bool | None, as_json: bool) -> int:
    """Print the statistics of a dataset.

    Exits with 1 if damaged episodes were skipped.
    """
    configure_logs()
    found = _measure_language(root) if language else measure_dataset(root, compare_paper)
    if as_json:
        print_json(found.model_dump(mode="json"))
    elif isinstance(found, Statistics):
        print_statistics(found)
    else:
        print_language(found)
    for remark in found.remarks:
        click.echo(f"{'damage' if remark.is_damage else 'note'}: {remark.file}: {remark.text}", err=True)
    return 0 if found.is_sound else 1


def _measure_language(root: Place) -> LanguageStatistics:
    from factory.stats.views import measure_language  # opens scene packages, which takes a second to import

    with Bars(transient=True) as bar:
        task = bar.add_task("episodes", total=None)
        return measure_language(root, lambda done, total: bar.update(task, completed=done, total=total))
