"""`--http`, `--http-token` and `--eval`: options of commands that serve pages. Serves nothing."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar

import click

from schemas.support.extras import require_package

Command = TypeVar("Command", bound=Callable[..., Any])


def http_options(command: Command) -> Command:
    """`--http HOST:PORT --http-token FILE`."""
    for option in (
        click.option(
            "--http-token",
            type=click.Path(path_type=Path, dir_okay=False),
            metavar="FILE",
            help="File whose first line is the token of the pages; /healthz and /readyz need no token. "
            "Required if --http is not a loopback address.",
        ),
        click.option(
            "--http",
            metavar="HOST:PORT",
            callback=_require_pages,
            help="Address to serve the status pages /healthz, /readyz and /metrics on; a run also serves its web page "
            "if the extra `web` is installed. Default: no pages.",
        ),
    ):
        command = option(command)
    return command


def run_http_options(command: Command) -> Command:
    """`--http HOST:PORT --http-token FILE --eval DIR` of a run."""
    return http_options(evaluations_option(command))


def evaluations_option(command: Command) -> Command:
    """`--eval DIR`."""
    return click.option(
        "--eval",
        "evaluations",
        type=click.Path(path_type=Path, file_okay=False),
        metavar="DIR",
        multiple=True,
        help="Output directory of `factory eval` to show on the web page; repeatable. Default: none.",
    )(command)


def _require_pages(context: click.Context, param: click.Parameter, http: str | None) -> str | None:  # noqa: ARG001
    if http is not None:
        require_package("prometheus_client", "--http")
        require_package("uvicorn", "--http")
    return http
