"""`--http` and `--http-token`: status pages of long-running commands."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, TypeVar

import click

from coordinator.status.address import parse_address
from coordinator.status.health import StatusSource
from schemas.errors import UsageError
from schemas.support.extras import require_package

Command = TypeVar("Command", bound=Callable[..., Any])


def http_options(command: Command) -> Command:
    """`--http HOST:PORT --http-token FILE`."""
    for option in (
        click.option(
            "--http-token",
            type=click.Path(path_type=Path, dir_okay=False),
            metavar="FILE",
            help="File whose first line is the bearer token of /metrics. Required if --http is not a loopback address.",
        ),
        click.option(
            "--http",
            metavar="HOST:PORT",
            callback=_require_pages,
            help="Address to serve the status pages /healthz, /readyz and /metrics on. Default: no status pages.",
        ),
    ):
        command = option(command)
    return command


def _require_pages(context: click.Context, param: click.Parameter, http: str | None) -> str | None:  # noqa: ARG001
    if http is not None:
        require_package("prometheus_client", "--http")
        require_package("tornado", "--http")
    return http


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
    if http is None:
        if token_file is not None:
            raise UsageError("--http-token requires --http: give the address to serve on, e.g. --http 127.0.0.1:9464")
        yield
        return
    from coordinator.status.server import StatusServer  # its packages are an extra

    token = read_token(token_file) if token_file is not None else None
    with StatusServer(parse_address(http, token), source, token) as server:
        click.echo(f"status pages on {server.url}/metrics", err=True)
        yield


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
