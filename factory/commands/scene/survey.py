"""`factory scene survey`: measures the start points of a scene, or the diversity of the layouts of a family."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import asdict
from itertools import count
from typing import TYPE_CHECKING

import click

from factory.commands.common.output import print_json, print_table, print_text
from factory.commands.scene.choice import chosen_scene
from factory.commands.scene.diversity import survey_family
from schemas.terms import SuccessMeasure

if TYPE_CHECKING:
    from factory.scenes.survey.spawn_survey import SpawnSight, SurveyReport


def execute(
    scene: str | None, seed: int, family: str | None, layouts: int, within: float, success: str | None, as_json: bool
) -> int:
    """Executes `factory scene survey`."""
    from factory.scenes.survey.spawn_survey import report_survey

    if (scene is None) == (family is None):
        raise click.UsageError("give either SCENE|PACKAGE or --family NAME")
    if scene is None:
        return survey_family(str(family), layouts, seed, as_json)
    chosen = chosen_scene(scene, seed)
    usual = SuccessMeasure.SURFACE if chosen.info.has_footprints else SuccessMeasure.CENTROID
    report = report_survey(chosen, within, SuccessMeasure(success or usual))
    if as_json:
        print_json(asdict(report))
    else:
        for line in describe_survey(report):
            print_text(line)
        click.echo("")
        print_table(
            "", ("start point", "x m", "y m", "visible targets", "categories"), map(_row, count(), report.sights)
        )
    for reason in report.shortcomings:
        click.echo(f"error: {reason}", err=True)
    return 1 if report.shortcomings else 0


def describe_survey(report: SurveyReport) -> Iterator[str]:
    """Yields the measures, one line each."""
    from factory.scenes.navigation.reach import SEE_RANGE_M

    low, high = SEE_RANGE_M
    yield f"start points (spawns of the far tier): {report.spawns}"
    yield f"connected free floor: {report.free_area_m2:g} m2 that the robot can reach"
    yield (
        f"distance to the nearest other start point: median {report.nearest_median_m:g} m, minimum "
        f"{report.nearest_min_m:g} m"
    )
    yield (
        f"floor within {report.within_m:g} m of a start point: {100 * report.share_within:.1f} %; largest distance of "
        f"free floor to a start point: {report.farthest_floor_m:g} m"
    )
    yield (
        f"start points without a visible target: {report.blind}; used only by the planner, and by other experts if "
        "spawn.screening is none or sight"
    )
    yield f"targets visible from no start point: {', '.join(report.unseen) or 'none'}"
    goal = "centroid" if report.success is SuccessMeasure.CENTROID else "footprint"
    yield f"visible: at {low:g} to {high:g} m, not occluded, with a free straight path to 1 m from the {goal}"


def _row(number: int, sight: SpawnSight) -> tuple[object, ...]:
    return (number, sight.x_m, sight.y_m, sight.targets, ", ".join(sight.categories) or "-")
