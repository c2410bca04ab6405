"""`factory gather`: copies the episodes stored by several gateways into one dataset."""

from __future__ import annotations

from datetime import UTC, datetime
from pathlib import Path

import click

from coordinator.gateway.gather import GatherReport, gather
from factory.cli.common.bars import one_bar
from factory.cli.common.options import ledger_option
from factory.cli.common.output import json_option, print_result, print_table, say_building
from factory.support.logs import configure_logs
from factory.support.settings import scene_cache
from factory.verify.repair_input import inspect_dataset

_LISTED = 20


@click.command("gather")
@click.argument("root", metavar="DIR", type=click.Path(path_type=Path, file_okay=False))
@click.argument("sources", metavar="[GATEWAY_DIR]...", nargs=-1, type=click.Path(path_type=Path, file_okay=False))
@click.option(
    "--requeue-missing",
    is_flag=True,
    help="Requeue episodes that are in none of the directories; they are generated again with the same content.",
)
@ledger_option
@json_option
def command(root: Path, sources: tuple[Path, ...], requeue_missing: bool, ledger: str | None, as_json: bool) -> int:
    """Copy the episodes stored by gateways into one dataset.

    DIR is the coordinator's dataset directory; stop its coordinator first. GATEWAY_DIR is the --out of a gateway, or a
    copy of it; it is not changed. Each episode is checked against the ledger. If you give only some of the gateways'
    directories, run the command again with the others. Exits with 1 if episodes are missing and not requeued.
    """
    configure_logs()
    with one_bar("gathering") as tell:
        found = inspect_dataset(root, root, None, ledger, scene_cache(), say_building)
        report = gather(found, sources, datetime.now(UTC), requeue_missing=requeue_missing, on_progress=tell)
    print_result(report, as_json, _print)
    return 1 if report.missing and not report.requeued else 0


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
