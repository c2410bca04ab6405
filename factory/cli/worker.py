"""`factory worker`: simulations of this host for a coordinator anywhere."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any, cast

import click

from coordinator.wire.tls import read_credentials
from factory.cli.options import renderer_option, tls_option, verbose_option
from factory.listen import require_endpoints
from factory.logs import configure_logs
from schemas.child import python_module
from schemas.terms import RendererKind
from workers.settings import WorkerSettings
from workers.stopping import stop_at_eof, stop_on_signals
from workers.supervisor import run_worker

__all__ = ["command"]


@click.command("worker")
@click.option("--cores", type=click.IntRange(1, 1024), default=1, show_default=True, help="Simulations at a time.")
@click.option(
    "--connect",
    multiple=True,
    metavar="ENDPOINT",
    help="A coordinator or gateway; repeat it, or write a comma between, for several: the worker takes any and changes "
    "over by itself when that one is gone. Default tcp/127.0.0.1:7447, with --tls tls/127.0.0.1:7447.",
)
@renderer_option
@click.option("--spool", type=click.Path(path_type=Path), help="Where finished bundles wait; default: user's cache.")
@click.option(
    "--wait",
    "wait_s",
    type=click.FloatRange(0.0),
    default=30.0,
    show_default=True,
    help="Seconds to look for the coordinator at the start.",
)
@click.option("--import-policies", is_flag=True, help="Let evaluations name classes that are imported here.")
@click.option("--until-eof", is_flag=True, hidden=True, help="Leave when stdin is closed.")
@tls_option
@verbose_option
def command(
    cores: int,
    connect: tuple[str, ...],
    renderer: str,
    spool: Path | None,
    wait_s: float,
    import_policies: bool,
    until_eof: bool,
    tls: Path | None,
    verbose: bool,
) -> int:
    """Simulate jobs for the coordinator until its run is finished; SIGTERM gives back what is under way."""
    configure_logs(verbose)
    connect = tuple(part.strip() for given in connect for part in given.split(","))
    more: dict[str, Any] = {} if spool is None else {"spool_dir": spool}
    require_endpoints(connect, with_tls=tls is not None)
    if tls is not None:
        more["tls"], more["host"] = read_credentials(tls)
    settings = WorkerSettings(
        connect=connect or (f"{'tcp' if tls is None else 'tls'}/127.0.0.1:7447",),
        cores=cores,
        renderer=cast(RendererKind, renderer),
        wait_s=wait_s,
        errand_command=_errand_command(renderer, import_policies),
        **more,
    )
    with stop_on_signals() as (stop, at_once):
        if until_eof:
            stop_at_eof(sys.stdin.fileno(), stop)
        return run_worker(settings, stop, at_once)


def _errand_command(renderer: str, import_policies: bool) -> tuple[str, ...]:
    return python_module("factory.eval.station", "--renderer", renderer, *["--import-policies"] * import_policies)
