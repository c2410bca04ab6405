"""`factory repair`: repairs a damaged dataset, or lists the necessary actions with `--dry-run`."""

from __future__ import annotations

from datetime import UTC, datetime

import click

from coordinator.expansion.plan_file import load_plan
from coordinator.recovery.repair_dataset import RepairReport, repair
from coordinator.recovery.survey import count_plans
from coordinator.validation.validator import Validator
from factory.commands.common.bars import one_bar
from factory.commands.common.output import print_building, print_result, print_table
from factory.dataset.site import Site
from factory.support.logs import configure_logs
from factory.support.settings import scene_cache
from factory.verify.repair_input import inspect_dataset
from schemas.plan import Plan
from schemas.terms import SuccessMeasure


def execute(
    site: Site, dry_run: bool, take_over: bool, plan_name: str | None, ledger: str | None, as_json: bool
) -> int:
    """Executes `factory repair`."""
    configure_logs()
    plan = _plan_of(plan_name, site) if plan_name is not None else None
    with one_bar("checking files") as tell, Validator() as validator:
        found = inspect_dataset(site.place, site.state_dir, plan, ledger, scene_cache(), print_building)
        report = repair(
            found,
            validator,
            datetime.now(UTC),
            apply=not dry_run,
            take_over=take_over,
            on_progress=tell,
        )
    print_result(report, as_json, _print)
    return 1 if dry_run and not report.is_sound else 0


def _plan_of(name: str, site: Site) -> Plan:
    """Returns a plan; if its file has no success measure, the plan gets that of most episodes in the dataset."""
    counts = count_plans(site.place)
    return max((load_plan(name, success) for success in reversed(SuccessMeasure)), key=lambda plan: counts[plan.digest])


def _print(report: RepairReport) -> None:
    if report.actions:
        print_table("", ("action", "file or episode", "reason"), [(a.kind, a.what, a.why) for a in report.actions])
    done = "executed" if report.applied else "required (dry run; nothing was changed)"
    verdict = f"{len(report.actions)} actions {done}" if report.actions else "nothing to repair"
    click.echo(f"{report.dataset}: {verdict}; {report.episodes} of {report.planned} episodes are valid")
    if report.applied and report.episodes < report.planned:
        click.echo(f"generate the missing episodes with: factory run --out {report.dataset}", err=True)
