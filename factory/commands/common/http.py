"""`--http`, `--http-token` and `--eval`: status pages of long-running commands, and the web page of a run."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING

import click

from coordinator.status.address import parse_address
from coordinator.status.health import StatusSource
from schemas.errors import UsageError
from schemas.support.extras import install_command

if TYPE_CHECKING:
    from coordinator.service import Coordinator  # imports zenoh
    from factory.dataset.site import Site


@contextmanager
def status_pages(source: StatusSource, http: str | None, token_file: Path | None) -> Iterator[None]:
    """Serves status pages while the context is open, if `--http` is given.

    Args:
        source: source of the values on the pages.
        http: value of `--http`.
        token_file: value of `--http-token`.

    Raises:
        UsageError: the address is malformed or unprotected, or the extra is missing.
        WorldError: the address is in use.
    """
    _require_http(http, token_file)
    if http is None:
        yield
        return
    from coordinator.status.server import StatusServer  # needs an extra

    token = read_token(token_file) if token_file is not None else None
    with StatusServer(parse_address(http, token), source, token) as server:
        click.echo(f"status pages on {server.url}/metrics", err=True)
        yield


@contextmanager
def run_pages(
    coordinator: Coordinator,
    site: Site,
    http: str | None,
    token_file: Path | None,
    ledger: str | None,
    evaluations: Sequence[Path],
) -> Iterator[None]:
    """Serves the web page and the status pages of a run while the context is open, if `--http` is given.

    Without the extra `web`, only the status pages are served, and a note names the extra.

    Args:
        coordinator: coordinator of the run.
        site: location of the dataset.
        http: value of `--http`.
        token_file: value of `--http-token`.
        ledger: URL of the ledger; `None` for the ledger of the dataset.
        evaluations: values of `--eval`; a directory that does not exist yet is shown as soon as it exists.

    Raises:
        UsageError: the address is malformed or unprotected, or the extra `metrics` is missing.
        WorldError: the address is in use.
    """
    if http is None or not (find_spec("starlette") and find_spec("uvicorn")):
        with status_pages(coordinator.health, http, token_file):
            if http is not None:
                click.echo(f"to serve the web page, too, install its packages: {install_command('web')}", err=True)
            yield
        return
    from factory.web.pages.status import routes  # needs an extra
    from factory.web.start import serve

    token = read_token(token_file) if token_file is not None else None
    more = routes(coordinator.health)
    with serve(site, http, token, None, ledger, coordinator.administer, more, evaluations) as url:
        click.echo(f"web page and /metrics: {url}", err=True)
        yield


def check_run_evaluations(http: str | None, evaluations: Sequence[Path]) -> None:
    """Checks `--eval` of a run before the run starts.

    Raises:
        UsageError: evaluations are given without `--http`.
        WorldError: a directory exists and is not an evaluation.
    """
    if evaluations and http is None:
        raise UsageError("--eval requires --http: give the address to serve on, e.g. --http 127.0.0.1:9464")
    if evaluations:
        from factory.eval.results.store import read_manifest

        for folder in filter(Path.exists, evaluations):
            read_manifest(folder)


def _require_http(http: str | None, token_file: Path | None) -> None:
    if http is None and token_file is not None:
        raise UsageError("--http-token requires --http: give the address to serve on, e.g. --http 127.0.0.1:9464")


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
