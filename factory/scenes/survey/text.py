"""Prints the survey of a scene, and builds and compares the layouts of a family: `factory scene survey`."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict
from itertools import count

import click

from factory.scenes.author.scene import BUILTIN_SCENES, lay_out_scene
from factory.scenes.build import build_scene
from factory.scenes.navigation.reach import SEE_RANGE_M
from factory.scenes.survey.diversity import (
    Distribution,
    LayoutFacts,
    coarse_map,
    measure_layout,
    nearest_neighbours,
    spreads,
)
from factory.scenes.survey.spawn_survey import SpawnSight, SurveyReport
from factory.support.settings import scene_cache
from factory.support.terminal import print_json, print_table, print_text, stderr
from schemas.errors import UsageError, WorldError
from schemas.scene import read_geometry
from schemas.support.numpy_types import Bools
from schemas.support.suggest import did_you_mean
from schemas.terms import SuccessMeasure, layout_name

_TRIES_PER_LAYOUT = 3


def print_survey(report: SurveyReport) -> None:
    """Prints the measures of a survey, and a table of the start points."""
    for line in describe_survey(report):
        print_text(line)
    click.echo("")
    print_table("", ("start point", "x m", "y m", "visible targets", "categories"), map(_row, count(), report.sights))


def describe_survey(report: SurveyReport) -> Iterator[str]:
    """Yields the measures, one line each."""
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


def survey_family(family: str, layouts: int, first_seed: int, as_json: bool) -> int:
    """Measures layouts of consecutive seeds; layouts in the scene cache are not built again.

    Returns:
        The exit status: 0, or 1 if too many seeds have no layout.

    Raises:
        UsageError: the family is unknown.
    """
    if family not in BUILTIN_SCENES:
        known = ", ".join(BUILTIN_SCENES)
        raise UsageError(f"{family!r} is not a family; families: {known}{did_you_mean(family, BUILTIN_SCENES)}")
    facts: list[LayoutFacts] = []
    maps: dict[int, Bools] = {}
    failed: dict[int, str] = {}
    seeds = iter(range(first_seed, first_seed + _TRIES_PER_LAYOUT * layouts))
    with stderr.status(f"surveying {family}") as progress:
        while len(facts) < layouts and (seed := next(seeds, None)) is not None:
            progress.update(f"surveying {family}: {len(facts)} of {layouts} layouts, seed {seed}")
            try:
                scene = read_geometry(build_scene(family, seed, scene_cache(), called=layout_name(family, seed)))
            except WorldError as error:
                failed[seed] = str(error)
                continue
            facts.append(measure_layout(seed, lay_out_scene(BUILTIN_SCENES[family], seed), scene))
            maps[seed] = coarse_map(scene)
    nearest, spread = nearest_neighbours(maps), spreads(facts)
    if as_json:
        print_json(
            {
                "family": family,
                "layouts": [asdict(each) for each in facts],
                "distributions": {name: asdict(each) for name, each in spread.items()},
                "nearest": [{"seed": seed, "other": other, "distance": far} for seed, (other, far) in nearest.items()],
                "failed": [{"seed": seed, "reason": reason} for seed, reason in failed.items()],
            }
        )
    else:
        _print_family(family, facts, spread, nearest)
    for seed, reason in failed.items():
        click.echo(f"note: seed {seed} has no layout: {reason}", err=True)
    if len(facts) < layouts:
        click.echo(f"error: {len(facts)} of {layouts} layouts were built; use another --seed", err=True)
    return 0 if len(facts) == layouts else 1


def _print_family(
    family: str,
    facts: Sequence[LayoutFacts],
    spread: Mapping[str, Distribution],
    nearest: Mapping[int, tuple[int, float]],
) -> None:
    rows = [(name, each.least, each.median, each.greatest, each.deviation) for name, each in spread.items()]
    print_table(f"{family}: {len(facts)} layouts", ("property", "least", "median", "greatest", "deviation"), rows)
    if nearest:
        click.echo("")
        distances = sorted(far for _, far in nearest.values())
        seed, (other, far) = min(nearest.items(), key=lambda item: item[1][1])
        print_text(
            f"distance to the nearest other layout (share of occupied cells not in common): median "
            f"{distances[len(distances) // 2]:.2f}, minimum {far:.2f} (seeds {seed} and {other})"
        )
