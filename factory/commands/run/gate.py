"""`factory gate`: measures the success rate of first attempts in one scene; exits with 1 if it is too low."""

from __future__ import annotations

import os
import tempfile
from pathlib import Path

import click

from coordinator.expansion.plan_file import load_plan
from factory.commands.common.gating import try_scene
from factory.commands.common.output import print_building, print_result, print_table
from factory.commands.common.plan_changes import shrunk_plan
from factory.runs.catalog import open_catalog
from factory.runs.gate import GateReport
from factory.stats.statistics import Share
from factory.support.logs import configure_logs
from factory.support.settings import scene_cache
from schemas.plan import Plan
from schemas.support.extras import require_package
from schemas.terms import RendererKind
from workers.client.stopping import stop_on_signals
from workers.experts import require_expert


def execute(
    scene: str,
    plan_name: str,
    episodes: int,
    min_success: float,
    expert: str | None,
    seed: int | None,
    workers: int | None,
    renderer: RendererKind,
    as_json: bool,
    verbose: bool,
) -> int:
    """Executes `factory gate`."""
    configure_logs(verbose)
    require_package("pybullet", "`factory gate`")
    changes = {"scenes": (scene,), "episodes": episodes, "expert": expert, "seed": seed}
    plan = shrunk_plan(load_plan(plan_name), changes)
    require_expert(plan.expert)
    report = _try(plan, renderer, workers or os.cpu_count() or 1, min_success)
    if report is None:
        click.echo("interrupted; no result", err=True)
        return 130
    print_result(report, as_json, _print)
    return 0 if report.passed else 1


def _try(plan: Plan, renderer: RendererKind, processes: int, min_success: float) -> GateReport | None:
    with stop_on_signals() as (stop, _), tempfile.TemporaryDirectory(prefix="gate-") as folder:
        catalog = open_catalog(plan, Path(folder), scene_cache(), print_building)
        return try_scene(plan, catalog, min_success, renderer, processes, stop)


def _print(report: GateReport) -> None:
    rows = [*((str(tier), share) for tier, share in report.by_tier.items()), ("all", report.success)]
    body = [(name, share.of, share.count, _percent(share), _interval(share)) for name, share in rows]
    print_table("", ("tier", "attempts", "succeeded", "success", "95 % interval"), body)
    if report.reasons:
        click.echo("failures: " + ", ".join(f"{count} {reason}" for reason, count in report.reasons.items()))
    for row in report.lost:
        click.echo(f"  {row.episode_id} {row.tier} {row.target_id}: {row.reason}: {row.detail}")
    verdict = "passed" if report.passed else "failed"
    required = f"{100 * report.min_success:g} % required"
    success = f"{_percent(report.success)} of first attempts succeeded"
    click.echo(f"{report.scene}, {report.expert} expert: {verdict}; {success}, {required}")


def _percent(share: Share) -> str:
    return "-" if share.share is None else f"{100 * share.share:.1f} %"


def _interval(share: Share) -> str:
    return "-" if share.low is None or share.high is None else f"{100 * share.low:.1f} to {100 * share.high:.1f} %"
