"""`factory serve`: serves the web page of a dataset and its run."""

from __future__ import annotations

from pathlib import Path

import click

from factory.commands.common.http import read_token
from factory.dataset.site import Site
from factory.support.logs import configure_logs
from schemas.errors import UsageError
from schemas.storage.dataset_files import EPISODES, is_dataset
from schemas.support.extras import require_package
from workers.client.stopping import stop_on_signals


def execute(
    site: Site,
    http: str,
    http_token: Path | None,
    evaluations: tuple[Path, ...],
    tls: Path | None,
    ledger: str | None,
    verbose: bool,
) -> None:
    """Executes `factory serve`."""
    configure_logs(verbose)
    for package in ("starlette", "uvicorn", "sqlalchemy"):
        require_package(package, "`factory serve`")
    if not (is_dataset(site.state_dir) or (site.place / EPISODES).is_dir()):
        raise UsageError(f"{site} is not a dataset; create one with `factory run demo --out {site}`")
    from factory.eval.results.store import read_manifest
    from factory.web.start import serve  # needs an extra

    for folder in evaluations:
        read_manifest(folder)  # raises its errors before the server starts
    token = read_token(http_token) if http_token is not None else None
    served = serve(site, http, token, tls, ledger, evaluations=evaluations, renders_ahead=True)
    with served as url, stop_on_signals() as (stop, _):
        click.echo(f"web page of {site}: {url}")
        stop.wait()
