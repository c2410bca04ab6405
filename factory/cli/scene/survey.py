"""`factory scene survey`: are there start points enough, and are they spread?"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import asdict
from itertools import count
from typing import TYPE_CHECKING

import click

from factory.cli.common.output import json_option, print_json, print_table, print_text
from factory.cli.scene.choice import chosen_scene, scene_argument, seed_option

if TYPE_CHECKING:
    from factory.scenes.survey.report import SpawnSight, SurveyReport

__all__ = ["command", "say_survey"]


@click.command("survey")
@scene_argument
@seed_option
@click.option(
    "--within",
    type=click.FloatRange(0.1),
    default=2.0,
    show_default=True,
    metavar="METRES",
    help="Distance from a start point within which floor counts as covered, metres.",
)
@json_option
def command(scene: str, seed: int, within: float, as_json: bool) -> int:
    """Measure the start points of a scene.

    SCENE is the name of a scene, PACKAGE a compiled scene (*.scene.zip).
    Exits with 1 when there are too few start points.
    """
    from factory.scenes.survey.report import report_survey

    report = report_survey(chosen_scene(scene, seed), within)
    if as_json:
        print_json(asdict(report))
    else:
        for line in say_survey(report):
            print_text(line)
        click.echo("")
        print_table("", ("spawn", "x m", "y m", "targets in sight", "categories"), map(_row, count(), report.sights))
    for reason in report.shortcomings:
        click.echo(f"error: {reason}", err=True)
    return 1 if report.shortcomings else 0


def say_survey(report: SurveyReport) -> Iterator[str]:
    """Yields what was measured, a line each with what it means."""
    from factory.scenes.survey.reach import SEE_RANGE_M

    low, high = SEE_RANGE_M
    yield f"spawns (start points of the far tier): {report.spawns}"
    yield f"connected floor: {report.free_area_m2:g} m2, where the robot fits and gets to from everywhere else"
    yield f"next spawn: {report.nearest_median_m:g} m away in the median, {report.nearest_min_m:g} m at least"
    yield (
        f"floor within {report.within_m:g} m of a spawn: {100 * report.share_within:.1f} %; the spot farthest from all "
        f"spawns is {report.farthest_floor_m:g} m away"
    )
    yield f"spawns without a target in sight: {report.blind}; only the planner expert starts there"
    yield f"targets in sight of no spawn: {', '.join(report.unseen) or 'none'}"
    yield f"in sight: {low:g} to {high:g} m away, nothing between, and a straight way there that is free"


def _row(number: int, sight: SpawnSight) -> tuple[object, ...]:
    return (number, sight.x_m, sight.y_m, sight.targets, ", ".join(sight.categories) or "-")
