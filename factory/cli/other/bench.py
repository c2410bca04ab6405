"""`factory bench`: measures collection, rendering, memory, coordinator and reader on this machine."""

from __future__ import annotations

import os

# numpy and Mesa read these when they are imported; the benchmarks measure one process on one core
os.environ.setdefault("LP_NUM_THREADS", "0")
os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import click

from coordinator.expansion.file import load_plan
from factory.bench.machine import StageRecorder, describe_machine
from factory.bench.model import CollectBench, RenderBench, RolloutBench
from factory.bench.reading.read import bench_read
from factory.bench.sample import first_attempts, make_sample, narrow
from factory.bench.service.coordinator import bench_coordinator
from factory.bench.simulation.collect import bench_collect
from factory.bench.simulation.memory import bench_memory
from factory.bench.simulation.render import bench_render
from factory.bench.simulation.rollout import bench_rollout
from factory.cli.common.bars import Bars
from factory.cli.common.filters import scene_filter
from factory.cli.common.groups import CommandGroup
from factory.cli.common.options import (
    count_option,
    former_option,
    plan_argument,
    pullers_option,
    record_option,
    renderer_option,
    shrunk_plan,
    workers_option,
)
from factory.cli.common.output import json_option, print_result
from factory.cli.common.places import PLACE
from factory.cli.other.bench_dataset import dataset
from factory.cli.other.bench_delivery import delivery
from factory.cli.other.bench_serve import serve
from factory.cli.other.bench_sessions import sessions
from factory.cli.other.bench_tables import (
    show_collect,
    show_coordinator,
    show_memory,
    show_read,
    show_render,
    show_rollout,
)
from factory.dataset.reader import Dataset
from factory.runs.catalog import open_catalog
from factory.support.logs import configure_logs
from factory.support.settings import scene_cache
from schemas.config import CameraConfig
from schemas.encoding.arrays import FRAME_SIZE_PX
from schemas.plan import Plan
from schemas.storage.place import Place
from schemas.terms import ExpertName, Recording, RendererKind
from workers.client.settings import WorkerSettings
from workers.render.process_wire import MAX_SIZE_PX
from workers.sim.scene_renderer import SceneRenderer

_PLAIN_FRAMES = 24
_SAMPLE_PLAN = "demo"
_MEMORY_JOBS = 25
"""Number of different jobs of each scene; they are repeated in turn."""


_repeats_option = count_option("--repeats", 3, "Number of timed runs; the result is their median.")
_size_option = count_option("--size", FRAME_SIZE_PX, "Width and height of the frames, pixels.", most=MAX_SIZE_PX)
_antialias_option = count_option("--antialias", 1, "Samples per pixel and axis; colours are their mean.", most=16)


@click.group("bench", cls=CommandGroup)
def command() -> None:
    """Measure the performance of this machine.

    Each result is the median over repeated runs of the same work.
    """
    configure_logs(verbose=False)


@command.command("rollout")
@plan_argument(default="paper")
@former_option("--plan", "plan_name", "PLAN")
@scene_filter()
@count_option("--episodes", 8, "Number of episodes of each scene.")
@_repeats_option
@record_option
@click.option("--against", type=click.Choice(["plain"]), help="Also measure a plain PyBullet pipeline for comparison.")
@count_option("--frames", _PLAIN_FRAMES, "Number of frames of the plain pipeline.", least=2)
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
    plan = shrunk_plan(narrow(load_plan(plan_name), scenes or (), episodes), {"record": record})
    machine, recorder = describe_machine(), StageRecorder()
    with _bar("rollout", len(plan.scenes) * (1 + episodes * repeats)) as tell, _temporary_folder() as folder:
        catalog = open_catalog(plan, folder, scene_cache())
        results = {}
        for name, entry in catalog.items():
            with SceneRenderer(renderer, recorder) as stage:
                jobs = first_attempts(plan, catalog, name)
                plain_frames = frames if against else 0
                results[name] = bench_rollout(jobs, entry, stage, recorder, repeats, plain_frames, tell)
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
    help="Recording to run; repeatable.",
)
@click.option(
    "--expert",
    "experts",
    type=click.Choice([str(name) for name in ExpertName]),
    multiple=True,
    help="Expert to run; repeatable.",
)
@workers_option("Number of simulation processes")
@_repeats_option
@renderer_option
@json_option
def collect(
    plan_name: str,
    scenes: tuple[str, ...] | None,
    episodes: int,
    records: tuple[Recording, ...],
    experts: tuple[ExpertName, ...],
    workers: int | None,
    repeats: int,
    renderer: RendererKind,
    as_json: bool,
) -> None:
    """Measure whole runs: episodes per hour and CPU time per episode.

    PLAN is a built-in plan (demo, paper, balanced, referring) or a TOML file; default: paper. Every combination of
    --record and --expert is run, in turns; by default those of the plan.
    """
    base = shrunk_plan(load_plan(plan_name), {"scenes": scenes, "episodes": episodes})
    variants = {
        f"{record}, {expert}": shrunk_plan(base, {"record": record, "expert": expert})
        for record in records or (base.record,)
        for expert in experts or (base.expert,)
    }
    machine, processes = describe_machine(), workers or os.cpu_count() or 1
    with _bar("collect", len(variants) * repeats) as tell, _temporary_folder() as folder:
        catalog = open_catalog(base, folder, scene_cache())
        paces = bench_collect(variants, catalog, folder, processes, repeats, renderer, tell)
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
    plan = narrow(load_plan(_SAMPLE_PLAN), scenes or (), 1)
    machine, recorder = describe_machine(), StageRecorder()
    with _bar("render", len(plan.scenes)) as tell, _temporary_folder() as folder:
        catalog = open_catalog(plan, folder, scene_cache())
        results = {}
        for name, entry in catalog.items():
            with SceneRenderer(renderer, recorder) as stage:
                scene = stage.load(entry.path, entry.sha256).scene
                results[name] = bench_render(
                    scene, stage.renderer, recorder, CameraConfig(), frames, repeats, size, antialias
                )
                described = stage.renderer.description
            tell()
    report = RenderBench(
        machine=machine, renderer=described, size=size, antialias=antialias, repeats=repeats, scenes=results
    )
    print_result(report, as_json, show_render)


@command.command("memory")
@scene_filter()
@count_option("--episodes", 200, "Total number of episodes; most are ended early.", least=20)
@renderer_option
@json_option
def memory(scenes: tuple[str, ...] | None, episodes: int, renderer: RendererKind, as_json: bool) -> None:
    """Measure the memory of a simulation over many episodes.

    The process switches to another scene after each episode.
    """
    plan = narrow(load_plan("paper"), scenes or (), _MEMORY_JOBS)
    with _bar("memory", episodes) as tell, _temporary_folder() as folder:
        catalog = open_catalog(plan, folder, scene_cache())
        turns = zip(*(first_attempts(plan, catalog, name) for name in catalog), strict=True)
        jobs = [job for turn in turns for job in turn]
        command = WorkerSettings(connect=(), renderer=renderer).simulation_command
        report = bench_memory(jobs, catalog, command, episodes, tell)
    print_result(report, as_json, show_memory)


@command.command("coordinator")
@count_option("--jobs", 100_000, "Number of jobs in the ledger.", least=1000, most=5_000_000)
@count_option("--workers", 64, "Number of concurrent simulated workers.", most=64)
@count_option("--sessions", 2000, "Number of concurrent network sessions.", most=4000)
@count_option("--bundle-mb", 32, "Size of each worker's bundle, MB.", most=256)
@pullers_option()
@_repeats_option
@json_option
def coordinator(
    jobs: int, workers: int, sessions: int, bundle_mb: int, pullers: int, repeats: int, as_json: bool
) -> None:
    """Measure a coordinator with a large ledger.

    Measures leases and submissions of real bundles, by direct calls and over the network. The memory is that of a
    separate coordinator process with all sessions connected, and while all workers send a bundle at the same time.
    """
    sample_plan = narrow(load_plan(_SAMPLE_PLAN), ("office",), 2)
    part = sample_plan.scenes[0].model_copy(update={"episodes": jobs})
    plan = load_plan("paper").model_copy(update={"scenes": (part,)})
    with _bar("coordinator", 2) as tell, _temporary_folder() as folder:
        catalog = open_catalog(sample_plan, folder, scene_cache())
        with SceneRenderer() as stage:
            samples = make_sample(folder / "sample", sample_plan, catalog, stage, tell)
        report = bench_coordinator(
            plan,
            catalog,
            samples,
            folder,
            workers=workers,
            sessions=sessions,
            bundle_bytes=bundle_mb * 1_000_000,
            repeats=repeats,
            pullers=pullers,
        )
    print_result(report, as_json, show_coordinator)


command.add_command(dataset)
command.add_command(serve)
command.add_command(delivery)
command.add_command(sessions)


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
    with _temporary_folder() as folder:
        if root is None:
            root = made = folder / "sample"
            _make_sample(made, narrow(load_plan(_SAMPLE_PLAN), scenes or (), 1), folder)
        chosen = Dataset(root).filter(**({"scene": scenes} if scenes else {}))
        report = bench_read(chosen, frames, repeats, workers, size, antialias)
    print_result(report, as_json, show_read)


def _make_sample(root: Path, plan: Plan, folder: Path) -> None:
    with _bar("sample", plan.episodes) as tell, SceneRenderer() as stage:
        make_sample(root, plan, open_catalog(plan, folder, scene_cache()), stage, tell)


@contextmanager
def _temporary_folder() -> Iterator[Path]:
    with tempfile.TemporaryDirectory(prefix="bench-") as folder:
        yield Path(folder)


@contextmanager
def _bar(name: str, total: int) -> Iterator[Callable[[], None]]:
    """Shows a progress bar; yields the function that advances it by one."""
    with Bars(refresh_per_second=1) as bar:
        task = bar.add_task(f"bench {name}", total=total)
        yield lambda: bar.advance(task)
