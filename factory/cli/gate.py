"""`factory gate`: measures the success rate of first attempts in one scene; exits with 1 if it is too low."""

from __future__ import annotations

import tempfile
from pathlib import Path
from typing import TYPE_CHECKING

import click

from coordinator.defaults import usable_cores
from factory.cli.options import (
    count_option,
    expert_option,
    json_option,
    number_option,
    plan_argument,
    plan_seed_option,
    renderer_option,
    verbose_option,
    workers_option,
)
from schemas.terms import BUILTIN_CATEGORIES

if TYPE_CHECKING:
    from schemas.terms import RendererKind


@click.command("gate")
@plan_argument(default="paper")
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
def command(
    plan_name: str,
    scene: str,
    episodes: int,
    min_success: float,
    expert: str | None,
    seed: int | None,
    workers: int | None,
    renderer: RendererKind,
    as_json: bool,
    verbose: bool,
) -> int:
    """Measure the success rate of first attempts in one scene.

    PLAN is a built-in plan (demo, paper, balanced, referring) or a TOML file; default: paper. Nothing is archived.
    Exits with 1 if the success rate is below --min-success. The paper requires 80 % of 50 attempts before it
    generates episodes in a scene.
    """
    from coordinator.expansion.plan_file import load_plan
    from factory.runs.catalog import open_catalog
    from factory.runs.gate import print_gate, try_scene
    from factory.runs.plan_changes import PlanChanges
    from factory.runs.start import shrunk_plan
    from factory.support.logs import configure_logs
    from factory.support.settings import scene_cache
    from factory.support.terminal import print_building, print_result
    from schemas.support.extras import require_package
    from workers.client.stopping import stop_on_signals
    from workers.experts import require_expert

    configure_logs(verbose)
    require_package("pybullet", "`factory gate`")
    changes = PlanChanges(scenes=(scene,), episodes=episodes, expert=expert, seed=seed)
    plan = shrunk_plan(load_plan(plan_name), changes)
    require_expert(plan.expert)
    processes = workers or usable_cores()
    with stop_on_signals() as (stop, _), tempfile.TemporaryDirectory(prefix="gate-") as folder:
        catalog = open_catalog(plan, Path(folder), scene_cache(), print_building)
        report = try_scene(plan, catalog, min_success=min_success, renderer=renderer, processes=processes, stop=stop)
    if report is None:
        click.echo("interrupted; no result", err=True)
        return 130
    print_result(report, as_json, print_gate)
    return 0 if report.passed else 1
