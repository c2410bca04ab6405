"""`factory run`: generates a dataset with coordinator and workers on this machine; continues interrupted runs."""

from __future__ import annotations

import os
import tempfile
import threading
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, ExitStack, contextmanager
from pathlib import Path
from typing import Any

import click

from coordinator.service import Coordinator
from coordinator.settings import CoordinatorSettings
from factory.commands.common.bars import Bars
from factory.commands.common.begin import begin
from factory.commands.common.gate_mode import GateMode
from factory.commands.common.gating import gate_plans, measure_gate
from factory.commands.common.http import check_run_evaluations, run_pages
from factory.commands.common.layout_bar import building_layouts
from factory.commands.common.output import print_building, print_result
from factory.commands.common.plan_changes import warn_of_empty_splits
from factory.commands.common.summary import print_missing, print_summary, summarise
from factory.dataset.site import Site
from factory.runs.catalog import open_catalog, scenes_before_run
from factory.runs.local import LocalRun, require_renderer, run_locally
from factory.runs.ray_engine import RayCluster
from factory.runs.shards import ShardRecorder, choose_shard, may_take_over
from factory.support.logs import configure_logs
from factory.support.settings import scene_cache
from factory.support.text import format_duration
from schemas.dataset.run_shard import RunShard
from schemas.errors import UsageError
from schemas.plan import Plan
from schemas.protocol.status import Progress
from schemas.storage.place import Place
from schemas.support.extras import require_package
from schemas.terms import RendererKind
from workers.client.stopping import stop_on_signals
from workers.experts import require_expert


def execute(
    plan_name: str | None,
    site: Site,
    workers: int | None,
    renderer: RendererKind,
    gate_mode: GateMode,
    shard: RunShard | None,
    packages: Place | None,
    engine: str,
    address: str | None,
    ledger: str | None,
    http: str | None,
    http_token: Path | None,
    evaluations: tuple[Path, ...],
    as_json: bool,
    verbose: bool,
    **changes: Any,
) -> int:
    """Executes `factory run`."""
    configure_logs(verbose)
    _check_options(engine, address, http, evaluations)
    if engine != "ray":  # with Ray, only the nodes of the cluster need a renderer
        require_renderer(renderer)
    plan, is_new = begin(plan_name, site, changes)
    require_expert(plan.expert)
    warn_of_empty_splits(plan)
    shard = choose_shard(site, shard, plan, ledger, is_new=is_new)
    processes = workers or os.cpu_count() or 1
    if not is_new or (shard is not None and gate_mode == "auto"):
        gate_mode = "skip"
    with ExitStack() as stack:
        stop, _ = stack.enter_context(stop_on_signals())
        all_before = shard is not None or packages is not None
        before = None if all_before else scenes_before_run(plan, gate_plans(plan, gate_mode))
        with building_layouts(processes, stop) as builds:
            catalog = open_catalog(plan, site.place, scene_cache(), print_building, builds, packages, before)
        gate = measure_gate(plan, catalog, gate_mode, renderer, processes, stop)
        if gate is None:
            click.echo("interrupted during the gate; no result was kept", err=True)
            return 130
        cluster = stack.enter_context(_open_cluster(address, workers, renderer)) if engine == "ray" else None
        run = LocalRun(
            plan,
            catalog,
            site.state_dir,
            processes,
            renderer,
            verbose,
            gate,
            site.store,
            ledger_url=ledger,
            shard=shard,
            take_over=shard is not None and may_take_over(site, stop),
            cluster=cluster,
        )
        progress = _run(
            run, site, stop, lambda coordinator: run_pages(coordinator, site, http, http_token, ledger, evaluations)
        )
    return _print_end(run, site, progress, as_json)


def _check_options(engine: str, address: str | None, http: str | None, evaluations: tuple[Path, ...]) -> None:
    require_package("pybullet", "`factory run`")
    if address is not None and engine != "ray":
        raise UsageError(f"--address {address} needs --engine ray")
    check_run_evaluations(http, evaluations)


def _print_end(run: LocalRun, site: Site, progress: Progress, as_json: bool) -> int:
    """Prints the result of the run and returns the exit code."""
    if not progress.finished:
        click.echo(f"interrupted; continue with: {run.command}", err=True)
        return 130
    print_result(summarise(site.place, progress), as_json, print_summary)
    print_missing(site, progress)
    return 1 if progress.missing else 0


def _run(
    run: LocalRun,
    site: Site,
    stop: threading.Event,
    pages: Callable[[Coordinator], AbstractContextManager[object]],
) -> Progress:
    recorder = None if run.shard is None else ShardRecorder(site, run.shard, run.plan, run.catalog)
    with RunBar(run.plan) as bar:

        def tell(progress: Progress) -> None:
            bar.tell(progress)
            if recorder is not None:
                recorder.record(progress)

        progress = run_locally(run, CoordinatorSettings(), stop, tell, pages)
    if recorder is not None:
        recorder.finish(progress)
    return progress


@contextmanager
def _open_cluster(address: str | None, cores: int | None, renderer: RendererKind) -> Iterator[RayCluster]:
    """Connects to a Ray cluster, with certificates in a temporary folder."""
    with (
        tempfile.TemporaryDirectory(prefix="minivla-ray-") as keys,
        RayCluster(address, Path(keys) / "pki", cores, renderer) as cluster,
    ):
        yield cluster


class RunBar(Bars):
    """Progress bar of a run: episodes, rate, time left, running jobs and failed attempts."""

    def __init__(self, plan: Plan) -> None:
        super().__init__()
        self._task = self.add_task(plan.name, total=plan.episodes)

    def tell(self, progress: Progress) -> None:
        """Updates the bar."""
        failures = sum(progress.failures.values())
        rate = "" if progress.episodes_per_hour is None else f"{progress.episodes_per_hour:.0f} episodes/h, "
        left = "" if progress.eta_s is None else f"{format_duration(progress.eta_s)} left, "
        layouts = f", {progress.built_layouts}" if progress.layouts else ""
        note = f"{rate}{left}{progress.jobs.get('leased', 0)} running, {failures} failed attempts{layouts}"
        self.update(self._task, total=progress.planned, completed=progress.jobs.get("archived", 0), note=note)
