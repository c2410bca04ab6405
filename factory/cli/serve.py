"""`factory serve`: serves the web page of a dataset and its run."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import click

from factory.cli.options import (
    evaluations_option,
    host_name_option,
    ledger_option,
    site_argument,
    tls_option,
    verbose_option,
)
from schemas.errors import UsageError
from schemas.storage.dataset_files import EPISODES, is_dataset
from schemas.support.extras import require_package
from schemas.support.shell import quoted

if TYPE_CHECKING:
    from factory.dataset.site import Site

_DEFAULT = "127.0.0.1:8080"


@click.command("serve")
@site_argument
@click.option(
    "--http",
    metavar="HOST:PORT",
    default=_DEFAULT,
    show_default=True,
    help="Address to serve on; port 0 selects a free port. An address that other machines can reach requires "
    "--http-token or --tls.",
)
@click.option(
    "--http-token",
    type=click.Path(path_type=Path, dir_okay=False),
    metavar="FILE",
    help="File whose first line is the token that every request requires. Default: a random token, "
    "required only for requests that change something.",
)
@host_name_option
@evaluations_option
@tls_option
@ledger_option
@verbose_option
def command(
    site: Site,
    http: str,
    http_token: Path | None,
    host_names: tuple[str, ...],
    evaluations: tuple[Path, ...],
    tls: Path | None,
    ledger: str | None,
    verbose: bool,
) -> None:
    """Serve the web page of a dataset, or of all datasets in a folder.

    Ends with Ctrl-C. Shows progress, workers, failures, episodes, scenes and statistics of a running or finished
    dataset. The printed URL contains the token, with which flags, notes and jobs can be changed.
    """
    from factory.support.logs import configure_logs
    from factory.web.serving import read_token
    from workers.client.stopping import stop_on_signals

    configure_logs(verbose)
    for package in ("starlette", "uvicorn", "sqlalchemy"):
        require_package(package, "`factory serve`")
    from factory.eval.results.store import read_manifest
    from factory.web.start import serve, serve_folder  # needs an extra

    is_folder = _is_folder(site)
    if is_folder and (evaluations or ledger is not None):
        option = "--eval" if evaluations else "--ledger or MINIVLA_LEDGER"
        raise UsageError(
            f"{site} is a folder of datasets, but {option} belongs to one dataset: serve the dataset alone"
        )
    for folder in evaluations:
        read_manifest(folder)  # raises its errors before the server starts
    token = read_token(http_token) if http_token is not None else None
    if is_folder:
        served = serve_folder(site.state_dir, http, token, tls, host_names)
    else:
        served = serve(
            site,
            http,
            token,
            tls=tls,
            ledger=ledger,
            evaluations=evaluations,
            renders_ahead=True,
            host_names=host_names,
        )
    with served as url, stop_on_signals() as (stop, _):
        click.echo(f"web page of {site}: {url}")
        stop.wait()


def _is_folder(site: Site) -> bool:
    """Returns whether a location is a folder of datasets and not a dataset.

    Raises:
        UsageError: it is neither.
    """
    from factory.web.folder import find_datasets

    if is_dataset(site.state_dir) or (site.place / EPISODES).is_dir():
        return False
    if site.store is None and site.state_dir.is_dir() and find_datasets(site.state_dir):
        return True
    raise UsageError(
        f"{site} is neither a dataset nor a folder of datasets; create a dataset with `factory run demo --out "
        f"{quoted(site)}`"
    )
