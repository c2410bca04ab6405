"""`factory scene survey`: are there start points enough, and are they spread?"""

from __future__ import annotations

from dataclasses import asdict

import click

from factory.cli.output import json_option, print_json, print_table
from factory.cli.scene_choice import chosen_scene, scene_argument, seed_option

__all__ = ["command"]


@click.command("survey")
@scene_argument
@seed_option
@click.option("--within", type=click.FloatRange(0.1), default=2.0, show_default=True, help="Covered floor, metres.")
@json_option
def command(scene: str, seed: int, within: float, as_json: bool) -> int:
    """Measure the start points of SCENE (the name of a scene, or a package); exit 1 when there are too few."""
    from factory.scenes.survey_report import SurveyReport, report_survey

    report: SurveyReport = report_survey(chosen_scene(scene, seed), within)
    if as_json:
        print_json(asdict(report))
    else:
        _print(asdict(report))
    for reason in report.shortcomings:
        click.echo(f"error: {reason}", err=True)
    return 1 if report.shortcomings else 0


def _print(facts: dict[str, object]) -> None:
    sights = facts.pop("sights")
    facts.pop("shortcomings")
    assert isinstance(sights, tuple)
    for key, value in facts.items():
        click.echo(f"{key}: {', '.join(value) or 'none' if isinstance(value, tuple) else value}")
    rows = [(k, s["x_m"], s["y_m"], s["targets"], ", ".join(s["categories"]) or "-") for k, s in enumerate(sights)]
    click.echo("")
    print_table("", ("spawn", "x m", "y m", "targets in sight", "categories"), rows)
