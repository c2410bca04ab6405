"""`factory repair`: puts a damaged dataset directory right, or says what would have to be done."""

from __future__ import annotations

from datetime import UTC, datetime

import click

from coordinator.expansion.file import load_plan
from coordinator.recovery.repair_dataset import repair
from coordinator.recovery.report import RepairReport
from coordinator.validation.validator import Validator
from factory.cli.common.bars import Bars
from factory.cli.common.options import ledger_option, site_argument
from factory.cli.common.output import json_option, print_json, print_table
from factory.dataset.site import Site
from factory.support.logs import configure_logs
from factory.support.settings import scene_cache
from factory.verify.repair_input import inspect_dataset

__all__ = ["command"]


@click.command("repair")
@site_argument
@click.option("--dry-run", is_flag=True, help="Print the actions and change nothing; exit with 1 when there are any.")
@click.option(
    "--plan",
    "plan_name",
    metavar="PLAN",
    help="Plan of the dataset, needed where neither the ledger nor dataset_meta.json has it.",
)
@click.option(
    "--take-over",
    is_flag=True,
    help="Take over a dataset in object storage whose former coordinator will not run again.",
)
@ledger_option
@json_option
def command(
    site: Site, dry_run: bool, take_over: bool, plan_name: str | None, ledger: str | None, as_json: bool
) -> int:
    """Repair a damaged dataset, its ledger and its tables.

    No coordinator may run on the dataset. Valid episodes that the ledger lacks are added to it; invalid files are moved
    to quarantine/; missing episodes are put back into the queue and are made again with the same content; a lost or
    damaged ledger is rebuilt from the plan and the episodes; the tables are written again. Every file is hashed.
    """
    configure_logs()
    plan = load_plan(plan_name) if plan_name is not None else None
    with Bars(transient=True) as bar, Validator() as validator:
        task = bar.add_task("examining", total=None)
        patient = inspect_dataset(
            site.place, site.home, plan, ledger, scene_cache(), lambda name: click.echo(f"building {name}", err=True)
        )
        report = repair(
            patient,
            validator,
            datetime.now(UTC),
            apply=not dry_run,
            take_over=take_over,
            on_progress=lambda done, total: bar.update(task, completed=done, total=total),
        )
    if as_json:
        print_json(report.model_dump(mode="json"))
    else:
        _print(report)
    return 1 if dry_run and not report.is_sound else 0


def _print(report: RepairReport) -> None:
    if report.actions:
        print_table("", ("action", "what", "why"), [(a.kind, a.what, a.why) for a in report.actions])
    done = "done" if report.applied else "to be done (dry run, nothing was changed)"
    verdict = f"{len(report.actions)} actions {done}" if report.actions else "nothing to repair"
    click.echo(f"{report.dataset}: {verdict}; {report.episodes} of {report.planned} episodes whole")
    if report.applied and report.episodes < report.planned:
        click.echo(f"make the rest with: factory run --out {report.dataset}", err=True)
