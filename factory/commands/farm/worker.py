"""`factory worker`: simulates jobs of a coordinator on this host."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

from coordinator.protocol.tls import read_credentials
from coordinator.validation.validator import Validator
from factory.scenes.requirements import can_build
from factory.support.listen import require_endpoints
from factory.support.logs import configure_logs
from schemas.support.child import python_module
from schemas.support.extras import require_package
from schemas.terms import RendererKind
from workers.client.settings import WorkerSettings
from workers.client.stopping import stop_at_eof, stop_on_signals
from workers.client.supervisor import run_worker


def execute(
    cores: int,
    connect: tuple[str, ...],
    renderer: RendererKind,
    spool: Path | None,
    wait_s: float,
    import_policies: bool,
    until_eof: bool,
    tls: Path | None,
    verbose: bool,
) -> int:
    """Executes `factory worker`."""
    configure_logs(verbose)
    require_package("pybullet", "`factory worker`")
    more: dict[str, Any] = {} if spool is None else {"spool_dir": spool}
    require_endpoints(connect, with_tls=tls is not None)
    if tls is not None:
        more["tls"], more["host"] = read_credentials(tls)
    with Validator(cores) as validator, stop_on_signals() as (stop, at_once):
        settings = WorkerSettings(
            connect=connect or (f"{'tcp' if tls is None else 'tls'}/127.0.0.1:7447",),
            cores=cores,
            renderer=renderer,
            wait_s=wait_s,
            check_bundle=validator.check,
            eval_command=_eval_command(renderer, import_policies),
            build_command=python_module("factory.runs.build_process") if can_build() else (),
            **more,
        )
        if until_eof:
            stop_at_eof(sys.stdin.fileno(), stop)
        return run_worker(settings, stop, at_once)


def _eval_command(renderer: RendererKind, import_policies: bool) -> tuple[str, ...]:
    return python_module(
        "factory.eval.remote.eval_worker", "--renderer", renderer, *["--import-policies"] * import_policies
    )
