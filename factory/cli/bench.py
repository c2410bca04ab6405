"""`factory bench`: measures rollout, whole runs, rendering and reading on this machine.

The benchmarks of single parts of the product are programs of `tests/benchmarks`.
"""

from __future__ import annotations

import os
import signal
from typing import TYPE_CHECKING

import click

from coordinator.defaults import usable_cores
from factory.cli.groups import CommandGroup
from factory.cli.options import (
    PLACE,
    count_option,
    json_option,
    plan_argument,
    record_option,
    renderer_option,
    scene_filter,
    workers_option,
)
from schemas.encoding.image_sizes import FRAME_SIZE_PX, MAX_SIZE_PX
from schemas.terms import ExpertName, Recording
from workers.process.one_core import ONE_THREAD

if TYPE_CHECKING:
    from pathlib import Path

    from schemas.plan import Plan
    from schemas.storage.place import Place
    from schemas.terms import RendererKind

MOVED = ("memory", "coordinator", "delivery", "sessions", "visited", "dataset", "serve")
"""Former subcommands; each is now a module of `tests.benchmarks`."""

_repeats_option = count_option("--repeats", 3, "Number of timed runs; the result is their median.")
_size_option = count_option("--size", FRAME_SIZE_PX, "Width and height of the frames, pixels.", most=MAX_SIZE_PX)
_antialias_option = count_option(
    "--antialias", 1, "Samples per pixel along each axis; colours are their mean.", most=16
)


class _BenchGroup(CommandGroup):
    """Group that names the new location of a former subcommand."""

    def resolve_command(
        self, ctx: click.Context, args: list[str]
    ) -> tuple[str | None, click.Command | None, list[str]]:
        if args[0] in MOVED:
            ctx.fail(
                f"the benchmark {args[0]!r} is no longer a part of the installed program; run it in a checkout of the "
                f"repository: python -m tests.benchmarks.{args[0]}"
            )
        return super().resolve_command(ctx, args)


@click.group("bench", cls=_BenchGroup)
def command() -> None:
    """Measure the performance of this machine.

    Each result is the median over repeated runs of the same work.
    """
    from factory.support.logs import configure_logs

    for name, value in ONE_THREAD.items():  # read by numpy and Mesa, which are not loaded yet
        os.environ.setdefault(name, value)
    configure_logs(verbose=False)
    signal.signal(signal.SIGTERM, signal.default_int_handler)  # ends the measured processes, too


@command.command("rollout")
@plan_argument(default="paper")
@scene_filter()
@count_option("--episodes", 8, "Number of episodes of each scene.")
@_repeats_option
@record_option
@click.option("--against", type=click.Choice(["plain"]), help="Also measure a plain PyBullet pipeline for comparison.")
@count_option("--frames", 24, "Number of frames of the plain pipeline.", least=2)
@renderer_option
@json_option
def rollout(
    plan_name: str,
    scenes: tuple[str, ...] | None,
    episodes: int,
    repeats: int,
    record: str | None,
    against: str | None,
    frames: int,
    renderer: RendererKind,
    as_json: bool,
) -> None:
    """Measure the speed of collection on one core.

    PLAN is a built-in plan (demo, paper, balanced, referring) or a TOML file; default: paper. Includes physics,
    control, rendering, encoding and writing of the bundle. `frames_per_s_per_core` uses wall-clock time.
    `frames_per_cpu_s` uses CPU time of the process, which does not depend on the load of the machine.
    """
    from coordinator.expansion.plan_file import load_plan, shrink
    from factory.bench.machine import StageRecorder, describe_machine
    from factory.bench.results import RolloutBench
    from factory.bench.rollout import bench_rollout
    from factory.bench.tables import progress_bar, show_rollout
    from factory.bench.workload import first_attempts, narrow, temporary_folder
    from factory.runs.catalog import open_catalog
    from factory.support.settings import scene_cache
    from factory.support.terminal import print_result
    from workers.sim.context import SimulationContext

    plan = shrink(narrow(load_plan(plan_name), scenes or (), episodes), record=Recording(record) if record else None)
    machine, recorder = describe_machine(), StageRecorder()
    with progress_bar("rollout", len(plan.scenes) * (1 + episodes * repeats)) as tell, temporary_folder() as folder:
        catalog = open_catalog(plan, folder, scene_cache())
        results = {}
        for name, entry in catalog.items():
            with SimulationContext(renderer, recorder) as stage:
                jobs = first_attempts(plan, catalog, name)
                plain_frames = frames if against else 0
                results[name] = bench_rollout(
                    jobs, entry, context=stage, recorder=recorder, repeats=repeats, plain_frames=plain_frames, tell=tell
                )
                described = stage.renderer.description
    report = RolloutBench(
        machine=machine,
        renderer=described,
        plan=plan.name,
        screening=plan.screening,
        repeats=repeats,
        scenes=results,
    )
    print_result(report, as_json, show_rollout)


@command.command("collect")
@plan_argument(default="paper")
@scene_filter()
@count_option("--episodes", 100, "Number of episodes of each run.")
@click.option(
    "--record",
    "records",
    type=click.Choice([str(kind) for kind in Recording]),
    multiple=True,
    help="Kind of recording to measure; repeatable.",
)
@click.option(
    "--expert",
    "experts",
    type=click.Choice([str(name) for name in ExpertName]),
    multiple=True,
    help="Expert to measure; repeatable.",
)
@workers_option("Number of simulation processes")
@_repeats_option
@renderer_option
@json_option
def collect(
    plan_name: str,
    scenes: tuple[str, ...] | None,
    episodes: int,
    records: tuple[str, ...],
    experts: tuple[str, ...],
    workers: int | None,
    repeats: int,
    renderer: RendererKind,
    as_json: bool,
) -> None:
    """Measure whole runs: episodes per hour and CPU time per episode.

    PLAN is a built-in plan (demo, paper, balanced, referring) or a TOML file; default: paper. Runs every combination
    of --record and --expert, in turns. Default: the recording and the expert of the plan.
    """
    from coordinator.expansion.plan_file import load_plan, shrink
    from factory.bench.collect import bench_collect
    from factory.bench.machine import describe_machine
    from factory.bench.results import CollectBench
    from factory.bench.tables import progress_bar, show_collect
    from factory.bench.workload import temporary_folder
    from factory.runs.catalog import open_catalog
    from factory.support.settings import scene_cache
    from factory.support.terminal import print_result

    base = shrink(load_plan(plan_name), scenes=scenes or (), episodes=episodes)
    variants = {
        f"{record}, {expert}": shrink(base, record=Recording(record), expert=ExpertName(expert))
        for record in records or (base.record,)
        for expert in experts or (base.expert,)
    }
    machine, processes = describe_machine(), workers or usable_cores()
    with progress_bar("collect", len(variants) * repeats) as tell, temporary_folder() as folder:
        catalog = open_catalog(base, folder, scene_cache())
        paces = bench_collect(
            variants, catalog, folder=folder, workers=processes, repeats=repeats, renderer=renderer, tell=tell
        )
    report = CollectBench(
        machine=machine,
        plan=base.name,
        screening=base.screening,
        workers=processes,
        repeats=repeats,
        variants=paces,
    )
    print_result(report, as_json, show_collect)


@command.command("render")
@scene_filter()
@count_option("--frames", 60, "Number of poses in each scene.")
@_size_option
@_antialias_option
@_repeats_option
@renderer_option
@json_option
def render(
    scenes: tuple[str, ...] | None,
    frames: int,
    size: int,
    antialias: int,
    repeats: int,
    renderer: RendererKind,
    as_json: bool,
) -> None:
    """Measure the speed of rendering.

    All runs render the same random poses of each scene, on one core: colour, depth and ids.
    """
    from coordinator.expansion.plan_file import load_plan
    from factory.bench.machine import StageRecorder, describe_machine
    from factory.bench.render import bench_render
    from factory.bench.results import RenderBench
    from factory.bench.tables import progress_bar, show_render
    from factory.bench.workload import SAMPLE_PLAN, narrow, temporary_folder
    from factory.runs.catalog import open_catalog
    from factory.support.settings import scene_cache
    from factory.support.terminal import print_result
    from schemas.config import CameraConfig
    from schemas.scene import read_scene
    from workers.render.choose import open_renderer

    plan = narrow(load_plan(SAMPLE_PLAN), scenes or (), 1)
    machine, recorder = describe_machine(), StageRecorder()
    with progress_bar("render", len(plan.scenes)) as tell, temporary_folder() as folder:
        catalog = open_catalog(plan, folder, scene_cache())
        results = {}
        for name, entry in catalog.items():
            with open_renderer(renderer, timer=recorder) as opened:
                scene = read_scene(entry.path)
                results[name] = bench_render(
                    scene,
                    opened,
                    recorder=recorder,
                    camera=CameraConfig(),
                    frames=frames,
                    repeats=repeats,
                    size=size,
                    antialias=antialias,
                )
                described = opened.description
            tell()
    report = RenderBench(
        machine=machine, renderer=described, size=size, antialias=antialias, repeats=repeats, scenes=results
    )
    print_result(report, as_json, show_render)


@command.command("read")
@click.argument("root", metavar="[DIR|URL]", required=False, type=PLACE)
@scene_filter()
@count_option("--frames", 500, "Number of random frames per run.")
@_size_option
@_antialias_option
@workers_option("Number of worker processes of the PyTorch DataLoader.", default=2, least=0)
@_repeats_option
@json_option
def read(
    root: Place | None,
    scenes: tuple[str, ...] | None,
    frames: int,
    size: int,
    antialias: int,
    workers: int,
    repeats: int,
    as_json: bool,
) -> None:
    """Measure random access to the frames of a dataset.

    Without DIR or URL, a few episodes of each scene are generated first.
    """
    from coordinator.expansion.plan_file import load_plan
    from factory.bench.read import bench_read
    from factory.bench.tables import show_read
    from factory.bench.workload import SAMPLE_PLAN, narrow, temporary_folder
    from factory.dataset.reader import Dataset
    from factory.support.terminal import print_result

    with temporary_folder() as folder:
        if root is None:
            root = made = folder / "sample"
            _simulate_sample(made, narrow(load_plan(SAMPLE_PLAN), scenes or (), 1), folder)
        chosen = Dataset(root).filter(**({"scene": scenes} if scenes else {}))
        report = bench_read(chosen, frames, repeats=repeats, workers=workers, size=size, antialias=antialias)
    print_result(report, as_json, show_read)


def _simulate_sample(root: Path, plan: Plan, folder: Path) -> None:
    from factory.bench.tables import progress_bar
    from factory.bench.workload import make_sample
    from factory.runs.catalog import open_catalog
    from factory.support.settings import scene_cache
    from workers.sim.context import SimulationContext

    with progress_bar("sample", plan.episodes) as tell, SimulationContext() as stage:
        make_sample(root, plan, catalog=open_catalog(plan, folder, scene_cache()), stage=stage, tell=tell)
