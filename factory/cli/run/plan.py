"""Declares `factory plan`: arguments, options and help."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from factory.cli.common.groups import CommandGroup
from factory.cli.common.options import json_option, plan_argument, shrink_options


@click.group("plan", cls=CommandGroup)
def command() -> None:
    """Show a plan's episode counts; find the nearest feasible plan."""


@command.command("show")
@plan_argument(default="demo")
@shrink_options
@json_option
def show(**options: Any) -> None:
    """Show a plan's quotas, categories, templates and ambiguity.

    PLAN is a built-in plan (demo, paper, balanced, referring) or a TOML file; default: demo. Files named in the
    plan must exist. Categories, templates, ambiguity and the share of far starts around a corner are shown only if
    all scenes are built and support the plan. For a plan with layouts, only the categories of the layouts are shown,
    except with balance = "instances".
    """
    from factory.commands.run.plan import show

    show(**options)


@command.command("nearest")
@plan_argument(default="demo")
@click.option(
    "-o",
    "--out",
    type=click.Path(path_type=Path, dir_okay=False),
    metavar="FILE",
    help="TOML file to write the plan to. Default: no file.",
)
@shrink_options
@json_option
def nearest(**options: Any) -> None:
    """Find the nearest plan that the scenes support.

    PLAN is a built-in plan (demo, paper, balanced, referring) or a TOML file; default: demo. Scenes that are not in
    the cache are built or imported. Layouts are not checked: if a layout cannot fulfil the plan, the run uses the
    layout of another seed.
    """
    from factory.commands.run.plan import nearest

    nearest(**options)
