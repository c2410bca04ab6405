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
from factory.commands.common.admission import choose_listening, find_hosts
from factory.commands.common.begin import begin
from factory.commands.common.gate_mode import GateMode
from factory.commands.common.gating import gate_plans, measure_gate
from factory.commands.common.http import check_run_evaluations, run_pages
from factory.commands.common.layout_bar import building_layouts
from factory.commands.common.output import print_building
from factory.commands.common.summary import print_missing
from factory.dataset.site import Site
from factory.runs.catalog import open_catalog, scenes_before_run, write_target_lists
from factory.runs.render import prepare_rendering
from factory.support.logs import configure_logs
from factory.support.settings import scene_cache
from schemas.errors import UsageError
from schemas.plan import Plan
from schemas.protocol.address_file import mark_finished
from schemas.protocol.messages import Hello
from schemas.protocol.status import Progress
from schemas.storage.disk import require_room
from schemas.storage.place import Place
from workers.client.stopping import stop_on_signals


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
    """Executes `factory coordinator start`."""
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
        if progress.finished:
            mark_finished(site.state_dir, plan.run)
    return _print_end(site, progress)


def _build(plan: Plan, site: Site, stop: threading.Event, gate_mode: GateMode) -> Catalog:
    """Returns the scenes that are needed before the run; builds missing ones until `stop` is set."""
    before = scenes_before_run(plan, gate_plans(plan, gate_mode))
    with building_layouts(os.cpu_count() or 1, stop) as builds:
        return open_catalog(plan, site.place, scene_cache(), print_building, builds, only=before)


def _print_joined(hello: Hello) -> None:
    click.echo(f"worker {hello.sid} joined with {hello.slots} cores", err=True)


def _wait(coordinator: Coordinator, stop: threading.Event, stay: bool) -> Progress:
    """Returns the progress after the run has finished and its workers have disconnected, or when `stop` is set.

    With `stay`, returns only when `stop` is set.
    """
    finished = coordinator.wait(stop=stop)
    if stay:
        stop.wait()
    elif finished:
        coordinator.wait_for_workers_to_disconnect(stop)
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
    where = "on loopback only" if guard is None else f"for the admitted hosts: {len(guard.admitted())}"
    click.echo(f"run {coordinator.run} in {site}: {plan.episodes} episodes, listening {where}", err=True)
    tls = "" if guard is None else " --tls DIR"
    for endpoint in coordinator.reachable:
        click.echo(f"factory worker --cores 2 --connect {endpoint}{tls}")
