"""Serves the status pages of long-running commands, and the web page of a run, as `--http` requests.

Importing this module needs no extra.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING

import click

from coordinator.status.address import parse_address
from coordinator.status.health import StatusSource
from factory.web.http_options import HttpOptions
from schemas.errors import UsageError
from schemas.support.extras import install_command

if TYPE_CHECKING:
    from coordinator.service import Coordinator  # imports zenoh
    from factory.dataset.site import Site


@contextmanager
def status_pages(source: StatusSource, options: HttpOptions) -> Iterator[None]:
    """Serves status pages while the context is open, if the options have an address.

    Args:
        source: source of the values on the pages.
        options: address and token of the pages.

    Raises:
        UsageError: the address is malformed or unprotected, or the extra is missing.
        WorldError: the address is in use.
    """
    if options.http is None and options.http_token is not None:
        raise UsageError("--http-token requires --http: give the address to serve on, e.g. --http 127.0.0.1:9464")
    if options.http is None and options.host_names:
        raise UsageError("--host-name requires --http: give the address to serve on, e.g. --http 127.0.0.1:9464")
    if options.http is None:
        yield
        return
    from coordinator.status.server import StatusServer  # needs an extra

    token = _token_of(options)
    with StatusServer(parse_address(options.http, token, names=options.host_names), source, token) as server:
        click.echo(f"status pages on {server.url}/metrics", err=True)
        yield


@contextmanager
def run_pages(coordinator: Coordinator, site: Site, options: HttpOptions, ledger: str | None) -> Iterator[None]:
    """Serves the web page and the status pages of a run while the context is open, if the options have an address.

    Without the extra `web`, only the status pages are served, and a note names the extra.

    Args:
        coordinator: coordinator of the run.
        site: location of the dataset.
        options: address and token of the pages, and the evaluations to show; the directory of an evaluation that does
            not exist yet is shown as soon as it exists.
        ledger: URL of the ledger; `None` for the ledger of the dataset.

    Raises:
        UsageError: the address is malformed or unprotected, or the extra `metrics` is missing.
        WorldError: the address is in use.
    """
    if options.http is None or not (find_spec("starlette") and find_spec("uvicorn")):
        with status_pages(coordinator.health, options):
            if options.http is not None:
                click.echo(f"to serve the web page, too, install its packages: {install_command('web')}", err=True)
            yield
        return
    from factory.web.pages.status import routes  # needs an extra
    from factory.web.start import serve

    with serve(
        site,
        options.http,
        _token_of(options),
        ledger=ledger,
        administer=coordinator.administer,
        more_routes=routes(coordinator.health),
        evaluations=options.evaluations,
        host_names=options.host_names,
    ) as url:
        click.echo(f"web page and /metrics: {url}", err=True)
        yield


def check_run_evaluations(options: HttpOptions) -> None:
    """Checks the evaluations of a run's page before the run starts.

    Raises:
        UsageError: evaluations are given without an address.
        WorldError: a directory exists and is not an evaluation.
    """
    if options.evaluations and options.http is None:
        raise UsageError("--eval requires --http: give the address to serve on, e.g. --http 127.0.0.1:9464")
    if options.evaluations:
        from factory.eval.results.store import read_manifest

        for folder in filter(Path.exists, options.evaluations):
            read_manifest(folder)


def _token_of(options: HttpOptions) -> str | None:
    return None if options.http_token is None else read_token(options.http_token)


def read_token(path: Path) -> str:
    """Returns the token in the first line of a file.

    Raises:
        UsageError: the file cannot be read.
    """
    try:
        return path.read_text(encoding="ascii").partition("\n")[0].strip()
    except (OSError, UnicodeDecodeError) as error:
        raise UsageError(
            f"cannot read a token from {path}: {error}; create one with: openssl rand -hex 16 > {path}"
        ) from error
