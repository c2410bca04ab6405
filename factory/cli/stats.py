"""`factory stats`: prints the tables of the paper, or those of instructions and objects in view."""

from __future__ import annotations

from typing import TYPE_CHECKING

import click

from factory.cli.options import compare_option, json_option, place_argument

if TYPE_CHECKING:
    from factory.stats import LanguageStatistics, Statistics
    from schemas.storage.place import Place


@click.command("stats")
@place_argument
@click.option(
    "--language",
    is_flag=True,
    help="Print how often the target can be found without language, how many objects the instructions fit, and how "
    "often the target is in view at the end. Reads two frames of each episode, for at most 2000 episodes.",
)
@compare_option
@json_option
def command(root: Place, language: bool, compare_paper: bool | None, as_json: bool) -> int:
    """Print the statistics of a dataset.

    Exits with 1 if damaged episodes were skipped.
    """
    from factory.stats import measure_dataset
    from factory.stats.text import print_language, print_statistics
    from factory.stats.views import measure_language
    from factory.support.logs import configure_logs
    from factory.support.terminal import Bars, print_result

    configure_logs()
    statistics: Statistics | LanguageStatistics
    if language:
        with Bars(transient=True) as bar:
            task = bar.add_task("episodes", total=None)
            statistics = measure_language(root, lambda done, total: bar.update(task, completed=done, total=total))
        print_result(statistics, as_json, print_language)
    else:
        statistics = measure_dataset(root, compare_paper)
        print_result(statistics, as_json, print_statistics)
    for remark in statistics.remarks:
        click.echo(f"{'damage' if remark.is_damage else 'note'}: {remark.file}: {remark.text}", err=True)
    return 0 if statistics.is_sound else 1
