"""`factory run`: generates a dataset with coordinator and workers on this machine; continues interrupted runs."""

from __future__ import annotations

from contextlib import ExitStack
from typing import TYPE_CHECKING, Any, NamedTuple

import click

from coordinator.defaults import usable_cores
from factory.cli.options import (
    PLACE,
    SHARD,
    gate_option,
    json_option,
    ledger_option,
    out_option,
    plan_argument,
    renderer_option,
    run_http_options,
    shrink_options,
    verbose_option,
    workers_option,
)
from schemas.errors import UsageError
from schemas.storage.dataset_files import SCENES
from schemas.support.shell import quoted

if TYPE_CHECKING:
    import threading
    from collections.abc import Callable, Mapping
    from contextlib import AbstractContextManager

    from coordinator.service import Coordinator
    from factory.dataset.site import Site
    from factory.merge.extend import Extension
    from factory.runs.gate_mode import GateMode
    from factory.runs.local import LocalRun
    from factory.runs.plan_changes import PlanChanges
    from factory.web.http_options import HttpOptions
    from schemas.dataset.run_shard import RunShard
    from schemas.plan import Plan
    from schemas.protocol.status import Progress
    from schemas.storage.place import Place
    from schemas.terms import RendererKind


_CHOICE = """\
no PLAN given, so the plan is `demo`, 16 episodes. Others:
  factory run paper --record states      1174 episodes; templates as in the paper, 98.6 % fit several objects
  factory run balanced --record states   1200 episodes; templates that fit one object of the scene or the view
  factory run referring                  1200 episodes; verified sentences that fit only the target, e.g. by relations
  factory plan new mine.toml             a plan of your own"""


@click.command("run")
@plan_argument(default=None)
@out_option
@workers_option("Number of simulation processes")
@renderer_option
@gate_option("auto")
@click.option(
    "--shard",
    type=SHARD,
    metavar="NUMBER/COUNT",
    help="Generate one of COUNT parts of the run, without a network connection to the others; `factory gather` joins "
    "them. No gate unless --gate requests it. Default: the shard that --out contains, or the whole run.",
)
@click.option(
    "--scenes",
    "packages",
    type=PLACE,
    metavar="DIR|URL",
    help="Folder with the compiled package of every scene, e.g. `scenes` of a dataset. Default: the packages in --out, "
    "or new ones.",
)
@click.option(
    "--engine",
    type=click.Choice(("local", "ray")),
    default="local",
    show_default=True,
    help="Where the simulations run. local: this machine; ray: every node of a Ray cluster, on all CPUs of a node or "
    "at most --workers of them.",
)
@click.option(
    "--address", metavar="ADDRESS", help="Address of the Ray cluster. Default: RAY_ADDRESS, or a new local one."
)
@click.option(
    "--extend",
    "extends",
    is_flag=True,
    help="Add episodes to the finished dataset in --out: up to --episodes N in all, or those that PLAN has more. "
    "Existing episodes keep their numbers and bytes.",
)
@click.option(
    "--dry-run", "is_dry", is_flag=True, help="Show the episodes, the size, the time and the free space; run nothing."
)
@ledger_option
@shrink_options
@run_http_options
@json_option
@verbose_option
def command(
    plan_name: str | None,
    site: Site,
    workers: int | None,
    renderer: RendererKind,
    gate_mode: GateMode,
    shard: RunShard | None,
    packages: Place | None,
    engine: str,
    address: str | None,
    extends: bool,
    is_dry: bool,
    ledger: str | None,
    changes: PlanChanges,
    pages: HttpOptions,
    as_json: bool,
    verbose: bool,
) -> int:
    """Generate a dataset from a plan, or continue an interrupted run.

    PLAN is a built-in plan (demo, paper, balanced, referring) or a TOML file; default: the plan of the dataset in
    --out, or demo. After Ctrl-C, SIGTERM or a crash, the same command continues the run; finished episodes are
    kept. Exits with 1 if episodes are missing at the end.
    """
    _begin_logs(verbose)
    _check_options(engine, address, renderer, pages)
    chosen = _choose(plan_name, site, changes, shard, ledger, packages, extends=extends)
    if chosen is None:
        click.echo(f"{site} has all requested episodes; nothing was run")
        return 0
    _note_plan(chosen.plan, is_chosen=plan_name is not None or not chosen.is_new)
    _check_disk(chosen.plan, None if is_dry or shard is not None else chosen.site)
    if is_dry:
        return _print_dry(chosen.plan, chosen.site, as_json)
    options = {"renderer": renderer, "verbose": verbose, "ledger_url": ledger}
    return _execute(chosen, workers, gate_mode, shard, engine, address, options, pages, as_json=as_json)


class _Chosen(NamedTuple):
    """Plan and place of the run that the options choose."""

    plan: Plan
    is_new: bool
    site: Site
    packages: Place | None
    extension: Extension | None


def _choose(
    plan_name: str | None,
    site: Site,
    changes: PlanChanges,
    shard: RunShard | None,
    ledger: str | None,
    packages: Place | None,
    *,
    extends: bool,
) -> _Chosen | None:
    """Returns the run; `None` if an extension has nothing to add."""
    from factory.runs.start import begin

    if not extends:
        plan, is_new = begin(plan_name, site, changes)
        return _Chosen(plan, is_new, site, packages, None)
    extension = _extension_of(plan_name, site, changes, shard, ledger)
    if extension is None:
        return None
    return _Chosen(extension.added, False, extension.site, extension.root / SCENES, extension)


def _execute(
    chosen: _Chosen,
    workers: int | None,
    gate_mode: GateMode,
    shard: RunShard | None,
    engine: str,
    address: str | None,
    options: Mapping[str, Any],
    pages: HttpOptions,
    *,
    as_json: bool,
) -> int:
    """Runs the plan, prints the result and returns the exit code.

    Args:
        options: fields of `LocalRun` that the command line sets as they are.
    """
    from factory.runs.gate import measure_gate
    from factory.runs.local import LocalRun
    from factory.runs.ray_engine import open_cluster
    from factory.runs.shards import choose_shard, may_take_over
    from factory.runs.start import open_scenes
    from factory.web.serving import run_pages
    from workers.client.stopping import stop_on_signals

    plan, is_new, site, packages, extension = chosen
    ledger, renderer = options["ledger_url"], options["renderer"]
    shard = choose_shard(site, shard, plan, ledger, is_new=is_new)
    gate_mode = "skip" if not is_new or (shard is not None and gate_mode == "auto") else gate_mode
    processes = workers or usable_cores()
    with ExitStack() as stack:
        stop, _ = stack.enter_context(stop_on_signals())
        catalog = open_scenes(
            plan, site, gate_mode, processes=processes, stop=stop, packages=packages, builds_all=shard is not None
        )
        gate = measure_gate(plan, catalog, gate_mode, renderer=renderer, processes=processes, stop=stop)
        if gate is None:
            return _say_interrupted()
        cluster = stack.enter_context(open_cluster(address, workers, renderer)) if engine == "ray" else None
        run = LocalRun(
            plan=plan,
            catalog=catalog,
            root=site.state_dir,
            workers=processes,
            gate=gate,
            store=site.store,
            shard=shard,
            take_over=shard is not None and may_take_over(site, stop),
            cluster=cluster,
            extends=None if extension is None else extension.root,
            **options,
        )
        progress = _run(run, site, stop, lambda coordinator: run_pages(coordinator, site, pages, ledger))
    if extension is not None and progress.finished and not progress.missing:
        return _add(extension, as_json)
    return _print_end(run, site, progress, as_json)


def _extension_of(
    plan_name: str | None, site: Site, changes: PlanChanges, shard: RunShard | None, ledger: str | None
) -> Extension | None:
    from factory.merge.extend import plan_extension

    if shard is not None or ledger is not None:
        raise UsageError("--extend cannot be combined with --shard or --ledger")
    return plan_extension(plan_name, site, changes)


def _add(extension: Extension, as_json: bool) -> int:
    """Adds the episodes of a finished extension, prints the result and returns the exit code."""
    from datetime import UTC, datetime

    from factory.merge.extend import add_extension
    from factory.support.terminal import print_json

    meta = add_extension(extension, datetime.now(UTC))
    added = meta.sources[-1]
    if as_json:
        print_json(meta.model_dump(mode="json", include={"run", "episodes", "planned", "complete", "dataset_digest"}))
        return 0
    click.echo(
        f"{extension.root}: {added.episodes} episodes added, numbers {added.numbers[0]}-{added.numbers[-1]}; the "
        "dataset "
        f"has {meta.episodes} of {meta.planned} episodes"
    )
    click.echo(f"digest  {meta.dataset_digest}\nnext:    factory verify {quoted(extension.root)} --deep")
    return 0


def _begin_logs(verbose: bool) -> None:
    from factory.support.logs import configure_logs

    configure_logs(verbose)


def _say_interrupted() -> int:
    click.echo("interrupted during the gate; no result was kept", err=True)
    return 130


def _note_plan(plan: Plan, *, is_chosen: bool) -> None:
    """Prints what users should know about a plan before its run, and checks its expert."""
    from factory.runs.start import warn_of_empty_splits
    from workers.experts import require_expert

    if not is_chosen:
        click.echo(_CHOICE, err=True)
    require_expert(plan.expert)
    warn_of_empty_splits(plan)


def _check_disk(plan: Plan, site: Site | None) -> None:
    """Raises an error if the disk is too small for a whole run in a local directory."""
    from factory.runs.estimate import count_archived, require_disk

    if site is not None and site.store is None:
        require_disk(plan, site.state_dir, count_archived(site))


def _print_dry(plan: Plan, site: Site, as_json: bool) -> int:
    from dataclasses import asdict

    from factory.runs.estimate import count_archived, estimate_run
    from factory.runs.plan_text import print_plan
    from factory.support.terminal import print_json, print_text
    from factory.support.text import format_bytes
    from schemas.storage.disk import free_bytes

    archived, free = count_archived(site), None if site.store is not None else free_bytes(site.state_dir)
    if as_json:
        estimate = asdict(estimate_run(plan))
        print_json({"run": plan.run, "estimate": estimate, "archived": archived, "free_bytes": free})
        return 0
    print_plan(plan)
    room = "" if free is None else f", {format_bytes(free)} free"
    print_text(f"{site}: {archived} of {plan.episodes} episodes exist{room}; nothing was run")
    return 0


def _check_options(engine: str, address: str | None, renderer: RendererKind, pages: HttpOptions) -> None:
    from factory.runs.local import require_renderer
    from factory.web.serving import check_run_evaluations
    from schemas.support.extras import require_package

    require_package("pybullet", "`factory run`")
    if address is not None and engine != "ray":
        raise UsageError(f"--address {address} needs --engine ray")
    check_run_evaluations(pages)
    if engine != "ray":  # with Ray, only the nodes of the cluster need a renderer
        require_renderer(renderer)


def _run(
    run: LocalRun,
    site: Site,
    stop: threading.Event,
    pages: Callable[[Coordinator], AbstractContextManager[object]],
) -> Progress:
    from coordinator.settings import CoordinatorSettings
    from factory.runs.local import run_locally
    from factory.runs.shards import ShardRecorder
    from factory.runs.summary import RunBar

    recorder = None if run.shard is None else ShardRecorder(site, run.shard, run.plan, run.catalog)
    with RunBar(run.plan) as bar:

        def on_progress(progress: Progress) -> None:
            bar.show(progress)
            if recorder is not None:
                recorder.record(progress)

        progress = run_locally(run, CoordinatorSettings(), stop=stop, tell=on_progress, pages=pages)
    if recorder is not None:
        recorder.finish(progress)
    return progress


def _print_end(run: LocalRun, site: Site, progress: Progress, as_json: bool) -> int:
    """Prints the result of the run and returns the exit code."""
    from factory.runs.summary import print_missing, print_summary, summarise
    from factory.support.terminal import print_result

    if not progress.finished:
        click.echo(f"interrupted; continue with: {run.command}", err=True)
        return 130
    print_result(summarise(site.place, progress), as_json, print_summary)
    print_missing(site, progress)
    return 1 if progress.missing else 0
