"""`factory gather`: copies the episodes of several gateways, or of the shards of a run, into one dataset."""

from __future__ import annotations

from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import click

from coordinator.expansion.plan_file import load_plan
from coordinator.gateway.gather import GatherReport, gather
from coordinator.ledger.opening import ledger_url_of
from coordinator.recovery.join_shards import JoinReport, JoinTarget, join_shards, require_joinable
from coordinator.validation.validator import Validator
from factory.commands.common.bars import one_bar
from factory.commands.common.output import print_building, print_result, print_table
from factory.commands.common.plan_changes import shrunk_plan
from factory.dataset.site import Site, dataset_directory
from factory.runs.catalog import open_catalog
from factory.runs.ledger import require_outside_datasets
from factory.support.logs import configure_logs
from factory.support.settings import scene_cache
from factory.verify.repair_input import inspect_dataset
from schemas.dataset.run_shard import ShardState, find_shards
from schemas.errors import UsageError
from schemas.plan import Plan
from schemas.storage.dataset_files import SCENES
from schemas.storage.place import Place

_LISTED = 20


def execute(
    first: str,
    sources: tuple[Place, ...],
    site: Site | None,
    requeue_missing: bool,
    ledger: str | None,
    as_json: bool,
    **changes: Any,
) -> int:
    """Executes `factory gather`."""
    configure_logs()
    if site is not None:
        return _join(shrunk_plan(load_plan(first), changes), sources, site, ledger, requeue_missing, as_json)
    given = [name for name, value in changes.items() if value]
    if given:
        raise UsageError(f"options that change PLAN ({', '.join(given)}) need --out, the dataset of the joined shards")
    root, folders = _directory(first), tuple(map(_directory, sources))
    with one_bar("gathering") as tell:
        found = inspect_dataset(root, root, None, ledger, scene_cache(), print_building)
        report = gather(found, folders, datetime.now(UTC), requeue_missing=requeue_missing, on_progress=tell)
    print_result(report, as_json, _print)
    return 1 if report.missing and not report.requeued else 0


def _directory(place: str | Place) -> Path:
    return dataset_directory(place, "`factory gather`")


def _join(
    plan: Plan, sources: tuple[Place, ...], site: Site, ledger: str | None, is_partial: bool, as_json: bool
) -> int:
    found = [one for source in sources for one in _shards_in(source)]
    require_joinable(found, plan, partial=is_partial)
    require_outside_datasets(site)
    catalog = open_catalog(plan, site.place, scene_cache(), print_building, packages=found[0][0] / SCENES)
    target = JoinTarget(site.place, site.state_dir, ledger_url_of(site.state_dir, ledger), plan, catalog)
    with one_bar("gathering shards") as tell, Validator() as checker:
        report = join_shards(target, found, checker, datetime.now(UTC), tell)
    print_result(report, as_json, _print_joined)
    return 1 if report.episodes < report.planned and not is_partial else 0


def _shards_in(source: Place) -> list[tuple[Place, ShardState]]:
    found = list(find_shards(source))
    if not found:
        raise UsageError(
            f"{source} is not a shard and contains none: give the --out of each `factory run --shard`, or a folder of "
            "them"
        )
    return found


def _print_joined(report: JoinReport) -> None:
    if report.rejected:
        rows = [(one.episode, one.shard, one.why) for one in report.rejected[:_LISTED]]
        print_table("", ("rejected", "shard", "reason"), rows)
    click.echo(
        f"{report.dataset}: {report.gathered} episodes and {report.failed_attempts} failed or returned attempts "
        f"gathered; the dataset has {report.episodes} of {report.planned} episodes"
    )
    click.echo(f"digest  {report.digest}")
    if report.episodes < report.planned:
        click.echo(f"generate the missing episodes with: factory run --out {report.dataset}", err=True)


def _print(report: GatherReport) -> None:
    if report.missing:
        rows = [(one.episode, one.gateway, one.why) for one in report.missing[:_LISTED]]
        print_table("", ("missing", "gateway", "reason"), rows)
    more = f" (the first {_LISTED} are listed)" if len(report.missing) > _LISTED else ""
    click.echo(
        f"{report.dataset}: {report.gathered} episodes gathered, {len(report.missing)} missing{more}; "
        f"the dataset has {report.episodes} of {report.planned} episodes"
    )
    if report.requeued:
        click.echo(f"generate the missing episodes with: factory run --out {report.dataset}", err=True)
    elif report.missing:
        click.echo(
            "give the directories of these gateways too, or --requeue-missing if the episodes are lost", err=True
        )
