"""`factory repair`: repairs a damaged dataset, or lists the necessary actions with `--dry-run`."""

from __future__ import annotations

from datetime import UTC, datetime
from typing import TYPE_CHECKING

import click

from factory.cli.options import json_option, ledger_option, site_argument
from schemas.support.shell import quoted
from schemas.terms import SuccessMeasure

if TYPE_CHECKING:
    from coordinator.recovery.repair_dataset import RepairReport
    from factory.dataset.site import Site
    from schemas.plan import Plan


@click.command("repair")
@site_argument
@click.option("--dry-run", is_flag=True, help="Print the actions without executing them; exit with 1 if there are any.")
@click.option(
    "--plan",
    "plan_name",
    metavar="PLAN",
    help="Plan of the dataset, a built-in name or a TOML file. Required only if both the ledger and "
    "dataset_meta.json are lost.",
)
@click.option(
    "--take-over",
    is_flag=True,
    help="Take over a dataset in object storage from a coordinator that will not run again.",
)
@ledger_option
@json_option
def command(
    site: Site, dry_run: bool, plan_name: str | None, take_over: bool, ledger: str | None, as_json: bool
) -> int:
    """Repair a damaged dataset, its ledger and its tables.

    Stop the coordinator of the dataset first. Every file is hashed. Valid episodes that are missing in the ledger are
    added to it. Invalid files are moved to quarantine/. Missing episodes are requeued; they are generated again with
    the same content. A lost or damaged ledger is rebuilt from the plan and the episodes. The tables are rewritten. A
    merged or extended dataset has no ledger: its missing episodes are simulated at once.
    """
    from coordinator.recovery.repair_dataset import repair
    from coordinator.validation.validator import Validator
    from factory.merge.repair_joined import joined_meta, repair_joined
    from factory.support.logs import configure_logs
    from factory.support.settings import scene_cache
    from factory.support.terminal import one_bar, print_building, print_result
    from factory.verify.repair_input import inspect_dataset

    configure_logs()
    if site.store is None and ledger is None and (meta := joined_meta(site.state_dir)) is not None:
        with one_bar("checking files") as on_progress, Validator() as validator:
            report = repair_joined(
                site.state_dir, meta, validator, datetime.now(UTC), apply=not dry_run, on_progress=on_progress
            )
        print_result(report, as_json, _print)
        return 1 if dry_run and not report.is_sound else 0
    plan = _plan_of(plan_name, site) if plan_name is not None else None
    with one_bar("checking files") as on_progress, Validator() as validator:
        dataset = inspect_dataset(
            site.place, site.state_dir, plan, url=ledger, cache=scene_cache(), tell=print_building
        )
        report = repair(
            dataset,
            validator,
            datetime.now(UTC),
            apply=not dry_run,
            take_over=take_over,
            on_progress=on_progress,
        )
    print_result(report, as_json, _print)
    return 1 if dry_run and not report.is_sound else 0


def _plan_of(name: str, site: Site) -> Plan:
    """Returns a plan; if its file has no success measure, the plan gets that of most episodes in the dataset."""
    from coordinator.expansion.plan_file import load_plan
    from coordinator.recovery.survey import count_plans

    counts = count_plans(site.place)
    return max((load_plan(name, success) for success in reversed(SuccessMeasure)), key=lambda plan: counts[plan.digest])


def _print(report: RepairReport) -> None:
    from factory.support.terminal import print_table

    if report.actions:
        print_table("", ("action", "file or episode", "reason"), [(a.kind, a.what, a.why) for a in report.actions])
    done = "executed" if report.applied else "required (dry run; nothing was changed)"
    verdict = f"{len(report.actions)} actions {done}" if report.actions else "nothing to repair"
    click.echo(f"{report.dataset}: {verdict}; {report.episodes} of {report.planned} episodes are valid")
    if report.applied and report.episodes < report.planned:
        click.echo(f"generate the missing episodes with: factory run --out {quoted(report.dataset)}", err=True)
