"""`factory gather`: copies the episodes of several gateways, or of the shards of a run, into one dataset."""

from __future__ import annotations

from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING

import click

from factory.cli.options import PLACE, SITE, json_option, ledger_option, shrink_options
from factory.dataset.site import Site, dataset_directory
from schemas.errors import UsageError
from schemas.storage.dataset_files import SCENES
from schemas.support.shell import quoted

if TYPE_CHECKING:
    from coordinator.gateway.gather import GatherReport
    from coordinator.recovery.join_shards import JoinReport
    from factory.runs.plan_changes import PlanChanges
    from schemas.dataset.run_shard import ShardState
    from schemas.plan import Plan
    from schemas.storage.place import Place

_LISTED = 20


@click.command("gather")
@click.argument("first", metavar="DIR|PLAN")
@click.argument("sources", metavar="[GATEWAY_DIR|SHARD]...", nargs=-1, type=PLACE)
@click.option(
    "-o",
    "--out",
    "site",
    metavar="DIR|URL",
    type=SITE,
    help="Join the shards of PLAN into this dataset. Default: gather the episodes of gateways into DIR.",
)
@click.option(
    "--requeue-missing",
    is_flag=True,
    help="Requeue episodes that are in none of the directories; they are generated again with the same content. With "
    "--out, shards may be missing or unfinished.",
)
@ledger_option
@shrink_options
@json_option
def command(
    first: str,
    sources: tuple[Place, ...],
    site: Site | None,
    requeue_missing: bool,
    ledger: str | None,
    changes: PlanChanges,
    as_json: bool,
) -> int:
    """Copy the episodes of gateways or shards into one dataset.

    Gateways: DIR is the coordinator's dataset directory; stop its coordinator first. GATEWAY_DIR is the --out of a
    gateway, or a copy of it; it is not changed. Each episode is checked against the ledger. If you give only some of
    the gateways' directories, run the command again with the others.

    Shards: `factory gather PLAN SHARD... --out DIR|URL` with PLAN and its options as in `factory run --shard`. SHARD is
    the --out of a shard, or a folder that contains several; it is not changed. The dataset has the digest that
    a run without shards gives.

    Exits with 1 if episodes are missing and not requeued.
    """
    from coordinator.expansion.plan_file import load_plan
    from coordinator.gateway.gather import gather
    from factory.runs.start import shrunk_plan
    from factory.support.logs import configure_logs
    from factory.support.settings import scene_cache
    from factory.support.terminal import one_bar, print_building, print_result
    from factory.verify.repair_input import inspect_dataset

    configure_logs()
    if site is not None:
        plan = shrunk_plan(load_plan(first), changes)
        return _join(plan, sources, site, ledger, is_partial=requeue_missing, as_json=as_json)
    given = [name for name, value in vars(changes).items() if value]
    if given:
        raise UsageError(f"options that change PLAN ({', '.join(given)}) need --out, the dataset of the joined shards")
    root, folders = _directory(first), tuple(map(_directory, sources))
    with one_bar("gathering") as on_progress:
        dataset = inspect_dataset(root, root, None, url=ledger, cache=scene_cache(), tell=print_building)
        report = gather(dataset, folders, datetime.now(UTC), requeue_missing=requeue_missing, on_progress=on_progress)
    print_result(report, as_json, _print)
    return 1 if report.missing and not report.requeued else 0


def _directory(place: str | Place) -> Path:
    return dataset_directory(place, "`factory gather`")


def _join(
    plan: Plan, sources: tuple[Place, ...], site: Site, ledger: str | None, *, is_partial: bool, as_json: bool
) -> int:
    """Joins shards into a new dataset and returns the exit code."""
    from coordinator.ledger.opening import ledger_url_of
    from coordinator.recovery.join_shards import JoinTarget, join_shards, require_joinable
    from coordinator.validation.validator import Validator
    from factory.runs.catalog import open_catalog
    from factory.runs.ledger import require_outside_datasets
    from factory.support.settings import scene_cache
    from factory.support.terminal import one_bar, print_building, print_result

    shards = [shard for source in sources for shard in _shards_in(source)]
    require_joinable(shards, plan, partial=is_partial)
    require_outside_datasets(site)
    catalog = open_catalog(plan, site.place, scene_cache(), print_building, packages=shards[0][0] / SCENES)
    target = JoinTarget(site.place, site.state_dir, ledger_url_of(site.state_dir, ledger), plan=plan, catalog=catalog)
    with one_bar("gathering shards") as on_progress, Validator() as checker:
        report = join_shards(target, shards, checker=checker, now=datetime.now(UTC), on_progress=on_progress)
    print_result(report, as_json, _print_joined)
    return 1 if report.episodes < report.planned and not is_partial else 0


def _shards_in(source: Place) -> list[tuple[Place, ShardState]]:
    from schemas.dataset.run_shard import find_shards

    shards = list(find_shards(source))
    if not shards:
        raise UsageError(
            f"{source} is not a shard and contains none: give the --out of each `factory run --shard`, or a folder of "
            "them"
        )
    return shards


def _print_joined(report: JoinReport) -> None:
    from factory.support.terminal import print_table

    if report.rejected:
        rows = [(one.episode, one.shard, one.why) for one in report.rejected[:_LISTED]]
        print_table("", ("rejected", "shard", "reason"), rows)
    click.echo(
        f"{report.dataset}: {report.gathered} episodes and {report.failed_attempts} failed or returned attempts "
        f"gathered; the dataset has {report.episodes} of {report.planned} episodes"
    )
    click.echo(f"digest  {report.digest or 'none until the missing episodes are generated'}")
    if report.episodes < report.planned:
        click.echo(f"generate the missing episodes with: factory run --out {quoted(report.dataset)}", err=True)


def _print(report: GatherReport) -> None:
    from factory.support.terminal import print_table

    if report.missing:
        rows = [(one.episode, one.gateway, one.why) for one in report.missing[:_LISTED]]
        print_table("", ("missing", "gateway", "reason"), rows)
    more = f" (the first {_LISTED} are listed)" if len(report.missing) > _LISTED else ""
    click.echo(
        f"{report.dataset}: {report.gathered} episodes gathered, {len(report.missing)} missing{more}; "
        f"the dataset has {report.episodes} of {report.planned} episodes"
    )
    if report.requeued:
        click.echo(f"generate the missing episodes with: factory run --out {quoted(report.dataset)}", err=True)
    elif report.missing:
        click.echo(
            "give the directories of these gateways too, or --requeue-missing if the episodes are lost", err=True
        )
