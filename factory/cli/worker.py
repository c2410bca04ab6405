"""`factory worker`: simulates jobs of a coordinator on this host."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from factory.cli.options import (
    connect_option,
    count_option,
    number_option,
    policy_limit_options,
    renderer_option,
    tls_option,
    verbose_option,
)

if TYPE_CHECKING:
    from schemas.terms import RendererKind


_SPARE_S = 30.0
"""Time beyond the limits of a policy after which its simulation counts as hung, seconds."""


@click.command("worker")
@count_option("--cores", 1, "Number of simulation processes, one per core.", most=1024)
@connect_option(
    "Endpoint of a coordinator or gateway, repeatable. The worker uses one and switches to another if it becomes "
    "unreachable. Default: tcp/127.0.0.1:7447; with --tls: tls/127.0.0.1:7447."
)
@renderer_option
@click.option(
    "--spool",
    type=click.Path(path_type=Path),
    metavar="DIR",
    help="Directory of finished bundles that the coordinator has not fetched yet. Default: in the user's cache.",
)
@number_option(
    "SECONDS",
    "--connect-timeout",
    30.0,
    "Timeout for the first connection to a coordinator, seconds.",
    "wait_s",
    least=0.0,
)
@click.option(
    "--policy",
    metavar="POLICY",
    help="Policy that drives in a run of `factory correct`, as in that command; its files must have the same content.",
)
@policy_limit_options
@click.option("--import-policies", is_flag=True, help="Allow evaluations to import policy classes on this host.")
@click.option("--until-eof", is_flag=True, hidden=True, help="Stop when stdin is closed.")
@tls_option
@verbose_option
def command(
    cores: int,
    connect: tuple[str, ...],
    renderer: RendererKind,
    spool: Path | None,
    wait_s: float,
    policy: str | None,
    act_timeout: float,
    load_timeout: float,
    import_policies: bool,
    until_eof: bool,
    tls: Path | None,
    verbose: bool,
) -> int:
    """Simulate jobs of a coordinator on this host.

    The worker exits with 0 when the run has finished. On SIGTERM it returns its running jobs to the coordinator and
    exits with 130.
    """
    from coordinator.protocol.tls import read_credentials
    from coordinator.validation.validator import Validator
    from factory.correct.driver import check_corrected
    from factory.correct.round import simulation_of
    from factory.scenes.requirements import can_build
    from factory.support.listen import require_endpoints
    from factory.support.logs import configure_logs
    from schemas.support.child import python_module
    from schemas.support.extras import require_package
    from workers.client.settings import WorkerSettings
    from workers.client.stopping import stop_at_eof, stop_on_signals
    from workers.client.supervisor import run_worker

    configure_logs(verbose)
    require_package("pybullet", "`factory worker`")
    if policy is not None:
        check_corrected(policy)
    more: dict[str, Any] = {} if spool is None else {"spool_dir": spool}
    if policy is not None:
        more["command"] = simulation_of(policy, renderer, act_timeout, load_timeout)
        more["start_s"] = more["hang_s"] = load_timeout + _SPARE_S
    policies = ["--import-policies"] if import_policies else []
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
            eval_command=python_module("factory.eval.remote.eval_worker", "--renderer", renderer, *policies),
            build_command=python_module("factory.runs.build_process") if can_build() else (),
            **more,
        )
        if until_eof:
            stop_at_eof(sys.stdin.fileno(), stop)
        return run_worker(settings, stop, at_once)
