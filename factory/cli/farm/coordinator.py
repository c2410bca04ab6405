"""`factory coordinator start`: starts the coordinator of a run, with workers on any host."""

from __future__ import annotations

import os
import threading
from pathlib import Path
from typing import Any

import click

from coordinator.expansion.catalog import Catalog
from coordinator.options import CoordinatorOptions
from coordinator.protocol.protocol import simulate_all
from coordinator.protocol.tls import Guard
from coordinator.service import Coordinator
from coordinator.settings import CoordinatorSettings
from factory.cli.common.admission import choose_listening, find_hosts
from factory.cli.common.begin import begin
from factory.cli.common.gating import GateMode, gate_option, gate_plans, measure_gate
from factory.cli.common.groups import CommandGroup
from factory.cli.common.http import check_run_evaluations, run_http_options, run_pages
from factory.cli.common.layout_bar import building_layouts
from factory.cli.common.options import (
    ledger_option,
    listen_option,
    number_option,
    out_option,
    plan_argument,
    pullers_option,
    shrink_options,
    tls_option,
    verbose_option,
)
from factory.cli.common.output import print_building
from factory.cli.common.places import PLACE
from factory.cli.common.summary import print_missing
from factory.dataset.site import Site
from factory.runs.catalog import open_catalog, scenes_before_run, write_target_lists
from factory.runs.render import prepare_rendering
from factory.support.logs import configure_logs
from factory.support.settings import scene_cache
from schemas.errors import UsageError
from schemas.plan import Plan
from schemas.protocol.messages import Hello
from schemas.protocol.status import Progress
from schemas.storage.disk import require_room
from schemas.storage.place import Place
from workers.client.stopping import stop_on_signals


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
    CoordinatorSettings().lease_ttl_s,
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
    http: str | None,
    http_token: Path | None,
    evaluations: tuple[Path, ...],
    gate_mode: GateMode,
    states: Place | None,
    verbose: bool,
    **changes: Any,
) -> int:
    """Assign the jobs of a plan to workers and archive their episodes.

    PLAN is a built-in plan (demo, paper, balanced, referring) or a TOML file; default: the plan of the dataset in
    --out, or demo. Exits when the run has finished: with 0, or with 1 if episodes are missing. Exits with 0 if it
    is stopped earlier. The gate (--gate) runs on this host before the first job is assigned.
    """
    configure_logs(verbose)
    check_run_evaluations(http, evaluations)
    guard, listen = choose_listening(tls, listen)
    if states is not None and plan_name is not None:
        raise UsageError(f"--states {states}: the plan is that of the dataset; omit PLAN {plan_name}")
    rendering = None
    if states is not None:
        rendering = prepare_rendering(states, site, rig=changes["rig"], appearance=changes["appearance"])
    plan, is_new = begin(plan_name, site, changes)
    settings = CoordinatorSettings(lease_ttl_s=lease_ttl_s, pullers=pullers, spot_checks=spot_checks)
    require_room(site.state_dir, settings.reserve_bytes)
    with stop_on_signals() as (stop, _):
        gate_mode = gate_mode if is_new else "skip"
        catalog = _build(plan, site, stop, gate_mode) if rendering is None else rendering.catalog
        gate = measure_gate(plan, catalog, gate_mode, "auto", os.cpu_count() or 1, stop)
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
        with (
            Coordinator(site.state_dir, plan, catalog, options) as coordinator,
            run_pages(coordinator, site, http, http_token, ledger, evaluations),
        ):
            write_target_lists(catalog, site.place)
            _print_endpoints(coordinator, plan, site, guard)
            progress = _wait(coordinator, stop, stay)
    return _print_end(site, progress)


def _build(plan: Plan, site: Site, stop: threading.Event, gate_mode: GateMode) -> Catalog:
    """Returns the scenes that are needed before the run; builds missing ones until `stop` is set."""
    before = scenes_before_run(plan, gate_plans(plan, gate_mode))
    with building_layouts(os.cpu_count() or 1, stop) as builds:
        return open_catalog(plan, site.place, scene_cache(), print_building, builds, only=before)


def _print_joined(hello: Hello) -> None:
    click.echo(f"worker {hello.sid} joined with {hello.slots} cores", err=True)


def _wait(coordinator: Coordinator, stop: threading.Event, stay: bool) -> Progress:
    """Waits for the end of the run and the departure of the workers, or with `stay` until `stop` is set."""
    finished = coordinator.wait(stop=stop)
    if stay:
        stop.wait()
    elif finished:
        coordinator.wait_for_departures(stop)
    return coordinator.progress()


def _print_end(site: Site, progress: Progress) -> int:
    """Prints the result of the run and returns the exit code."""
    if not progress.finished:
        click.echo(f"stopped; continue with: factory coordinator start --out {site}", err=True)
        return 0
    click.echo("finished", err=True)
    print_missing(site, progress)
    return 1 if progress.missing else 0


def _print_endpoints(coordinator: Coordinator, plan: Plan, site: Site, guard: Guard | None) -> None:
    """Prints where the coordinator listens, and the command that starts a worker."""
    where = "on loopback only" if guard is None else f"for {len(guard.admitted())} hosts"
    click.echo(f"run {coordinator.run} in {site}: {plan.episodes} episodes, listening {where}", err=True)
    tls = "" if guard is None else " --tls DIR"
    for endpoint in coordinator.reachable:
        click.echo(f"factory worker --cores 2 --connect {endpoint}{tls}")
