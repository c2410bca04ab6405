"""`factory status`: shows the progress of a run, read from its ledger or from a running coordinator."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import click

from factory.cli.options import SITE, connect_option, json_option, ledger_option, tls_option
from factory.dataset.site import Site, site_of
from schemas.errors import UsageError, WorldError
from schemas.storage.dataset_files import LEDGER_FILE, is_dataset, is_submitted_run

if TYPE_CHECKING:
    from collections.abc import Callable

    from schemas.protocol.status import Progress


@click.command("status")
@click.argument("site", metavar="[DIR|URL]", required=False, type=SITE)
@connect_option(
    "Endpoint of a running coordinator to ask, e.g. tcp/127.0.0.1:7447; repeatable. Default: read the ledger."
)
@ledger_option
@click.option("--watch", is_flag=True, help="Refresh every second until the run has finished.")
@tls_option
@json_option
def command(
    site: Site | None, connect: tuple[str, ...], ledger: str | None, watch: bool, tls: Path | None, as_json: bool
) -> None:
    """Show the progress of a run and its workers.

    Prints the number of jobs by scene, tier and split, the rate, the remaining time and the workers. Give the dataset
    (DIR or URL), or --connect. For a folder of shards, prints the last recorded state of each shard. For the
    folder of a run of `factory submit`, prints the state of its shards, or of its dataset once that exists.
    """
    from factory.runs.progress_text import draw_progress, draw_shards, shards_as_json, watch_progress
    from factory.support.terminal import print_json, stdout
    from schemas.dataset.run_shard import find_shards

    site = None if site is None else _inside(site)
    shards = list(find_shards(site.place)) if site is not None and not connect and not _has_ledger(site, ledger) else []
    if shards:
        print_json(shards_as_json(shards)) if as_json else stdout.print(draw_shards(shards), soft_wrap=False)
        return
    source = _source(site, connect, ledger, tls)
    if as_json:
        print_json(source().model_dump(mode="json"))
    elif watch:
        watch_progress(source)
    else:
        stdout.print(draw_progress(source()), soft_wrap=False)


def _inside(site: Site) -> Site:
    """Returns the location of the dataset or the shards if `site` is the folder of a submitted run, else `site`."""
    from schemas.dataset.run_shard import find_shards

    run = site.place
    if not isinstance(run, Path) or not is_submitted_run(run):
        return site
    if is_dataset(run / "dataset"):
        return site_of(run / "dataset")
    if not any(find_shards(run / "shards")):
        raise WorldError(
            f"no task of {run} has written its state yet; a task writes it some seconds after its start: see "
            f"`squeue` and the logs in {run / 'slurm'}"
        )
    return site_of(run / "shards")


def _has_ledger(site: Site, ledger: str | None) -> bool:
    return ledger is not None or (site.state_dir / LEDGER_FILE).is_file()


def _source(
    site: Site | None, connect: tuple[str, ...], ledger: str | None, tls: Path | None
) -> Callable[[], Progress]:
    if connect:
        from coordinator.protocol.ask import ask_progress
        from coordinator.protocol.tls import read_credentials
        from factory.support.listen import require_endpoints

        require_endpoints(connect, with_tls=tls is not None)
        if tls is None:
            return lambda: ask_progress(connect)
        files, name = read_credentials(tls)
        return lambda: ask_progress(connect, name, files)
    if site is None:
        raise UsageError("the dataset is missing: give DIR or URL, or --connect ENDPOINT")
    from factory.runs.ledger import progress_of

    return lambda: progress_of(site, ledger)
