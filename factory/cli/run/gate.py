"""Declares `factory gate`: arguments, options and help."""

from __future__ import annotations

from typing import Any

import click

from factory.cli.common.options import (
    count_option,
    expert_option,
    former_option,
    json_option,
    number_option,
    plan_argument,
    plan_seed_option,
    renderer_option,
    verbose_option,
    workers_option,
)
from schemas.terms import BUILTIN_CATEGORIES


@click.command("gate")
@plan_argument(default="paper")
@former_option("--plan", "plan_name", "PLAN")
@click.option(
    "--scene",
    required=True,
    metavar="SCENE",
    help=f"Scene of the plan to measure. Built-in: {', '.join(BUILTIN_CATEGORIES)}.",
)
@count_option("--episodes", 50, "Number of first attempts, one per episode.")
@number_option(
    "SHARE",
    "--min-success",
    0.8,
    "Minimum success rate, 0 to 1; below it the command exits with 1.",
    least=0.0,
    most=1.0,
)
@expert_option
@plan_seed_option
@workers_option("Number of simulation processes")
@renderer_option
@json_option
@verbose_option
def command(**options: Any) -> int:
    """Measure the success rate of first attempts in one scene.

    PLAN is a built-in plan (demo, paper, balanced, referring) or a TOML file; default: paper. Nothing is archived.
    Exits with 1 if the success rate is below --min-success. The paper requires 80 % of 50 attempts before it
    generates episodes in a scene.
    """
    from factory.commands.run.gate import execute

    return execute(**options)
