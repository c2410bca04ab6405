"""`factory coordinator start`: starts the coordinator of a run, with workers on any host."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import click

from coordinator.defaults import LEASE_TTL_S, usable_cores
from factory.cli.groups import CommandGroup
from factory.cli.options import (
    PLACE,
    gate_option,
    ledger_option,
    listen_option,
    number_option,
    out_option,
    plan_argument,
    pullers_option,
    run_http_options,
    shrink_options,
    tls_option,
    verbose_option,
)
from schemas.errors import UsageError
from schemas.support.shell import quoted

_POLL_S = 0.5
"""Pause between two checks of the coordinator while it stays after its run, seconds."""

if TYPE_CHECKING:
    import threading

    from coordinator.expansion.catalog import Catalog
    from coordinator.options import CoordinatorOptions
    from coordinator.protocol.tls import Guard
    from coordinator.service import Coordinator
    from factory.dataset.site import Site
    from factory.runs.gate_mode import GateMode
    from factory.runs.plan_changes import PlanChanges
    from factory.runs.render import Rendering
    from factory.web.http_options import HttpOptions
    from schemas.plan import Plan
    from schemas.protocol.messages import Hello
    from schemas.protocol.status import Progress
    from schemas.storage.place import Place


@click.group("coordinator", cls=CommandGroup)
def command() -> None:
    """Start the coordinator of a run whose workers are on other hosts."""


@command.command("start")
@plan_argument(default=None)
@out_option
@listen_option(
    "Endpoint to listen on for workers, repeatable; port 0 selects a free port. Default: tcp/127.0.0.1:7447; with "
    "--tls: tls/0.0.0.0:7447."
)
@ledger_option
@number_option(
    "SECONDS",
    "--lease",
    LEASE_TTL_S,
    "Lease time of a job, seconds. A worker that sends no heartbeat for this time loses its job.",
    "lease_ttl_s",
    least=1.0,
)
@pullers_option()
@click.option(
    "--spot-checks",
    type=click.FloatRange(0.0, 1.0),
    metavar="SHARE",
    help="Let the workers validate their bundles, and validate this share of them again, e.g. 0.05. A host whose "
    "bundle then fails is barred. Default: validate all bundles here.",
)
@click.option("--stay", is_flag=True, help="Do not exit when the run has finished; keep answering requests.")
@tls_option
@run_http_options
@gate_option("skip")
@click.option(
    "--states",
    type=PLACE,
    metavar="DIR|URL",
    help="Let the workers render the frames of this states dataset, instead of running PLAN. Default: run PLAN.",
)
@shrink_options
@verbose_option
def start(
    plan_name: str | None,
    site: Site,
    listen: tuple[str, ...],
    ledger: str | None,
    lease_ttl_s: float,
    pullers: int,
    spot_checks: float | None,
    stay: bool,
    tls: Path | None,
    pages: HttpOptions,
    gate_mode: GateMode,
    states: Place | None,
    changes: PlanChanges,
    verbose: bool,
) -> int:
    """Assign the jobs of a plan to workers and archive their episodes.

    PLAN is a built-in plan (demo, paper, balanced, referring) or a TOML file; default: the plan of the dataset in
    --out, or demo. Exits when the run has finished: with 0, or with 1 if episodes are missing. Exits with 130 if it
    is stopped earlier. The gate (--gate) runs on this host before the first job is assigned.
    """
    from coordinator.options import CoordinatorOptions
    from coordinator.protocol.protocol import simulate_all
    from coordinator.settings import CoordinatorSettings
    from factory.runs.gate import measure_gate
    from factory.runs.start import begin, open_scenes
    from factory.support.listen import choose_listening, find_hosts
    from factory.support.logs import configure_logs
    from factory.web.serving import check_run_evaluations
    from schemas.storage.disk import require_room
    from workers.client.stopping import stop_on_signals

    configure_logs(verbose)
    check_run_evaluations(pages)
    guard, listen = choose_listening(tls, listen)
    rendering = None if states is None else _open_states(states, site, plan_name, changes)
    plan, is_new = begin(plan_name, site, changes)
    settings = CoordinatorSettings(lease_ttl_s=lease_ttl_s, pullers=pullers, spot_checks=spot_checks)
    require_room(site.state_dir, settings.reserve_bytes)
    with stop_on_signals() as (stop, _):
        processes, gate_mode = usable_cores(), gate_mode if is_new else "skip"
        if rendering is None:
            catalog = open_scenes(plan, site, gate_mode, processes=processes, stop=stop)
        else:
            catalog = rendering.catalog
        gate = measure_gate(plan, catalog, gate_mode, renderer="auto", processes=processes, stop=stop)
        if gate is None:
            click.echo("interrupted during the gate; no result was kept", err=True)
            return 130
        options = CoordinatorOptions(
            listen=listen,
            hosts=() if guard is None else find_hosts(guard),
            ledger_url=ledger,
            settings=settings,
            guard=guard,
            gate=gate,
            store=site.store,
            on_joined=_print_joined,
            find_states=simulate_all if rendering is None else rendering.states,
        )
        progress = _serve(plan, catalog, site, options, pages=pages, stop=stop, stay=stay)
    return _print_end(site, progress)


def _open_states(states: Place, site: Site, plan_name: str | None, changes: PlanChanges) -> Rendering:
    """Returns the rendering of a states dataset.

    Raises:
        UsageError: a plan is given, too.
    """
    from factory.runs.render import prepare_rendering

    if plan_name is not None:
        raise UsageError(f"--states {states}: the plan is that of the dataset; omit PLAN {plan_name}")
    return prepare_rendering(states, site, rig=changes.rig, appearance=changes.appearance)


def _serve(
    plan: Plan,
    catalog: Catalog,
    site: Site,
    options: CoordinatorOptions,
    *,
    pages: HttpOptions,
    stop: threading.Event,
    stay: bool,
) -> Progress:
    """Runs the coordinator until the run has finished and its workers have disconnected, or until `stop` is set.

    With `stay`, runs it until `stop` is set.
    """
    from coordinator.service import Coordinator
    from factory.runs.catalog import write_target_lists
    from factory.web.serving import run_pages
    from schemas.protocol.address_file import mark_finished

    with (
        Coordinator(site.state_dir, plan, catalog, options) as coordinator,
        run_pages(coordinator, site, pages, options.ledger_url),
    ):
        write_target_lists(catalog, site.place)
        _print_endpoints(coordinator, plan, site, options.guard)
        finished = coordinator.wait(stop=stop)
        if stay:
            while not stop.wait(_POLL_S):
                coordinator.is_finished()  # raises an error of the coordinator itself
        elif finished:
            coordinator.wait_for_workers_to_disconnect(stop)
        progress = coordinator.progress()
    if progress.finished:
        mark_finished(site.state_dir, plan.run)
    return progress


def _print_joined(hello: Hello) -> None:
    click.echo(f"worker {hello.sid} joined with {hello.slots} cores", err=True)


def _print_end(site: Site, progress: Progress) -> int:
    """Prints the result of the run and returns the exit code."""
    from factory.runs.summary import print_missing

    if not progress.finished:
        click.echo(f"stopped; continue with: factory coordinator start --out {quoted(site)}", err=True)
        return 130
    click.echo("finished", err=True)
    print_missing(site, progress)
    return 1 if progress.missing else 0


def _print_endpoints(coordinator: Coordinator, plan: Plan, site: Site, guard: Guard | None) -> None:
    """Prints where the coordinator listens, and the command that starts a worker."""
    from factory.support.listen import split_resolvable
    from schemas.protocol.address_file import loopback_endpoints

    where = "on loopback only" if guard is None else f"for the admitted hosts: {len(guard.admitted())}"
    click.echo(f"run {coordinator.run} in {site}: {plan.episodes} episodes, listening {where}", err=True)
    tls = "" if guard is None else " --tls DIR"
    usable, unknown = split_resolvable(coordinator.reachable)
    for endpoint in usable or loopback_endpoints(coordinator.endpoints):
        click.echo(f"factory worker --cores 2 --connect {endpoint}{tls}")
    if unknown and not usable:
        click.echo(
            f"{', '.join(unknown)} cannot be resolved on this machine, so only its own workers can use the command "
            "above: for others, create the certificate again with `factory keys host DIR NAME --role coordinator "
            "--address ADDRESS --renew`, with an address of this machine",
            err=True,
        )
