"""`factory bench`: how fast the loop, its rendering, the coordinator and the reader are on this machine."""

from __future__ import annotations

import os

# read when numpy and Mesa are imported: what is measured is one process on one core
os.environ.setdefault("LP_NUM_THREADS", "0")
os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, TypeVar, cast

import click

from coordinator.archive.place import Place
from coordinator.plan.file import load_plan
from factory.bench.coordinator import bench_coordinator
from factory.bench.machine import describe_machine
from factory.bench.memory import bench_memory
from factory.bench.model import RenderBench, RolloutBench
from factory.bench.read import bench_read
from factory.bench.render import bench_render
from factory.bench.rollout import bench_rollout
from factory.bench.sample import make_sample
from factory.bench.watch import Watch
from factory.bench.work import first_attempts, narrow
from factory.catalog import open_catalog
from factory.cli.bars import Bars
from factory.cli.bench_tables import show_coordinator, show_memory, show_read, show_render, show_rollout
from factory.cli.options import renderer_option
from factory.cli.output import json_option, print_json
from factory.cli.places import PLACE
from factory.dataset import Dataset
from factory.logs import configure_logs
from factory.settings import scene_cache
from schemas.base import Model
from schemas.config import CameraConfig
from schemas.plan import Plan
from schemas.terms import BUILTIN_CATEGORIES, RendererKind
from workers.settings import WorkerSettings
from workers.stage import Stage

__all__ = ["command"]

_PLAIN_FRAMES = 24
_SAMPLE_PLAN = "demo"
_MEMORY_JOBS = 25
"""Different jobs of each scene; they are run in turn."""

Command = TypeVar("Command", bound=Callable[..., Any])
Report = TypeVar("Report", bound=Model)

_repeats_option = click.option("--repeats", type=click.IntRange(1), default=3, show_default=True, help="Timed runs.")
_scene_option = click.option(
    "--scene", "scenes", multiple=True, metavar="SCENE", help=f"Only this one ({', '.join(BUILTIN_CATEGORIES)}, ...)."
)


@click.group("bench")
def command() -> None:
    """Measure this machine; every figure is a median over repeated runs of the same work."""
    configure_logs(verbose=False)


@command.command("rollout")
@_scene_option
@click.option("--plan", "plan_name", default="paper", show_default=True, help="A built-in name or a TOML file.")
@click.option("--episodes", type=click.IntRange(1), default=8, show_default=True, help="Jobs of each scene.")
@_repeats_option
@click.option("--against", type=click.Choice(["plain"]), help="Also run the plain PyBullet pipeline.")
@click.option("--frames", type=click.IntRange(2), default=_PLAIN_FRAMES, show_default=True, help="Of the plain one.")
@renderer_option
@json_option
def rollout(
    scenes: tuple[str, ...],
    plan_name: str,
    episodes: int,
    repeats: int,
    against: str | None,
    frames: int,
    renderer: str,
    as_json: bool,
) -> None:
    """Time the whole loop on one core: physics, control, rendering, encoding, bundle.

    `frames_per_s_per_core` is wall clock, `frames_per_cpu_s` is CPU time of the process, which a busy machine
    does not change.
    """
    plan = narrow(load_plan(plan_name), scenes, episodes)
    machine, watch = describe_machine(), Watch()
    with _bar("rollout", len(plan.scenes) * (1 + episodes * repeats)) as tell, _nowhere() as nowhere:
        catalog = open_catalog(plan, nowhere, scene_cache())
        results = {}
        for name, entry in catalog.items():
            with Stage(cast(RendererKind, renderer), watch) as stage:
                jobs = first_attempts(plan, catalog, name)
                plain_frames = frames if against else 0
                results[name] = bench_rollout(jobs, entry, stage, watch, repeats, plain_frames, tell)
                described = stage.renderer.description
    report = RolloutBench(machine=machine, renderer=described, plan=plan.name, repeats=repeats, scenes=results)
    _print(report, as_json, show_rollout)


@command.command("render")
@_scene_option
@click.option("--frames", type=click.IntRange(1), default=60, show_default=True, help="Poses all over each scene.")
@_repeats_option
@renderer_option
@json_option
def render(scenes: tuple[str, ...], frames: int, repeats: int, renderer: str, as_json: bool) -> None:
    """Time rendering alone, at the same random poses on the floor of each scene."""
    plan = narrow(load_plan(_SAMPLE_PLAN), scenes, 1)
    machine, watch = describe_machine(), Watch()
    with _bar("render", len(plan.scenes)) as tell, _nowhere() as nowhere:
        catalog = open_catalog(plan, nowhere, scene_cache())
        results = {}
        for name, entry in catalog.items():
            with Stage(cast(RendererKind, renderer), watch) as stage:
                scene = stage.load(entry.path, entry.sha256).scene
                results[name] = bench_render(scene, stage.renderer, watch, CameraConfig(), frames, repeats)
                described = stage.renderer.description
            tell()
    _print(RenderBench(machine=machine, renderer=described, repeats=repeats, scenes=results), as_json, show_render)


@command.command("memory")
@_scene_option
@click.option("--episodes", type=click.IntRange(20), default=200, show_default=True, help="In all; most are cut short.")
@renderer_option
@json_option
def memory(scenes: tuple[str, ...], episodes: int, renderer: str, as_json: bool) -> None:
    """Watch one simulation's memory over many short episodes, in all scenes by turns."""
    plan = narrow(load_plan("paper"), scenes, _MEMORY_JOBS)
    with _bar("memory", episodes) as tell, _nowhere() as nowhere:
        catalog = open_catalog(plan, nowhere, scene_cache())
        turns = zip(*(first_attempts(plan, catalog, name) for name in catalog), strict=True)
        jobs = [job for turn in turns for job in turn]
        command = WorkerSettings(connect=(), renderer=cast(RendererKind, renderer)).simulation_command
        report = bench_memory(jobs, catalog, command, episodes, tell)
    _print(report, as_json, show_memory)


@command.command("coordinator")
@click.option("--jobs", type=click.IntRange(1000, 5_000_000), default=100_000, show_default=True, help="In the ledger.")
@click.option("--workers", type=click.IntRange(1, 64), default=64, show_default=True, help="Requests in flight.")
@click.option("--sessions", type=click.IntRange(1, 4000), default=2000, show_default=True, help="Connected at once.")
@click.option(
    "--bundle-mb", type=click.IntRange(1, 256), default=32, show_default=True, help="Of each worker's bundle."
)
@_repeats_option
@json_option
def coordinator(jobs: int, workers: int, sessions: int, bundle_mb: int, repeats: int, as_json: bool) -> None:
    """Time a coordinator with a large ledger: leases and submits, directly and over the network, and real bundles.

    The memory is that of a coordinator in a process of its own, with all sessions connected, and with all workers
    delivering a bundle at the same moment.
    """
    sample_plan = narrow(load_plan(_SAMPLE_PLAN), ("office",), 2)
    part = sample_plan.scenes[0].model_copy(update={"episodes": jobs})
    plan = load_plan("paper").model_copy(update={"scenes": (part,)})
    with _bar("coordinator", 2) as tell, _nowhere() as nowhere:
        catalog = open_catalog(sample_plan, nowhere, scene_cache())
        with Stage() as stage:
            samples = make_sample(nowhere / "sample", sample_plan, catalog, stage, tell)
        report = bench_coordinator(
            plan,
            catalog,
            samples,
            nowhere,
            workers=workers,
            sessions=sessions,
            bundle_bytes=bundle_mb * 1_000_000,
            repeats=repeats,
        )
    _print(report, as_json, show_coordinator)


@command.command("read")
@click.argument("root", metavar="[DIR|URL]", required=False, type=PLACE)
@_scene_option
@click.option("--frames", type=click.IntRange(1), default=500, show_default=True, help="Random frames a run.")
@click.option("--workers", type=click.IntRange(0, 64), default=2, show_default=True, help="Of the torch loader.")
@_repeats_option
@json_option
def read(root: Place | None, scenes: tuple[str, ...], frames: int, workers: int, repeats: int, as_json: bool) -> None:
    """Time random access to the frames of a dataset; without one to a few episodes of every scene, made for it."""
    with _nowhere() as nowhere:
        if root is None:
            root = made = nowhere / "sample"
            _make_sample(made, narrow(load_plan(_SAMPLE_PLAN), scenes, 1), nowhere)
        report = bench_read(Dataset(root).filter(**({"scene": scenes} if scenes else {})), frames, repeats, workers)
    _print(report, as_json, show_read)


def _make_sample(root: Path, plan: Plan, nowhere: Path) -> None:
    with _bar("sample", plan.episodes) as tell, Stage() as stage:
        make_sample(root, plan, open_catalog(plan, nowhere, scene_cache()), stage, tell)


@contextmanager
def _nowhere() -> Iterator[Path]:
    with tempfile.TemporaryDirectory(prefix="bench-") as folder:
        yield Path(folder)


@contextmanager
def _bar(name: str, total: int) -> Iterator[Callable[[], None]]:
    """Shows a bar and gives the function that moves it on by one."""
    with Bars(refresh_per_second=1) as bar:
        task = bar.add_task(f"bench {name}", total=total)
        yield lambda: bar.advance(task)


def _print(report: Report, as_json: bool, show: Callable[[Report], None]) -> None:
    if as_json:
        print_json(report.model_dump(mode="json"))
    else:
        show(report)
