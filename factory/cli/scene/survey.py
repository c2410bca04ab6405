"""Declares `factory scene survey`: arguments, options and help."""

from __future__ import annotations

from typing import Any

import click

from factory.cli.common.options import count_option, json_option, number_option
from factory.cli.scene.choice import complete_scene, seed_option
from schemas.terms import SuccessMeasure


@click.command("survey")
@click.argument("scene", metavar="[SCENE|PACKAGE]", required=False, shell_complete=complete_scene)
@seed_option
@click.option(
    "--family", metavar="NAME", help="Family whose layouts to compare, instead of one scene. Seeds start at --seed."
)
@count_option("--layouts", 20, "Number of layouts of --family.", least=1, most=10_000)
@number_option(
    "METRES", "--within", 2.0, "Floor within this distance of a start point counts as covered, metres.", least=0.1
)
@click.option(
    "--success",
    type=click.Choice([str(measure) for measure in SuccessMeasure]),
    help="Measure of the distance to the targets. Default: surface if the package has footprints, otherwise centroid.",
)
@json_option
def command(**options: Any) -> int:
    """Measure the start points of a scene, or the diversity of a family.

    SCENE is the name of a scene; PACKAGE is a scene package (*.scene.zip).
    Exits with 1 if there are too few start points or layouts.
    """
    from factory.commands.scene.survey import execute

    return execute(**options)
