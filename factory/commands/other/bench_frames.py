"""`factory bench render` and `factory bench read`: measure rendering and reading of frames, without PyBullet.

PyBullet is needed only to generate episodes for a measurement.
"""

from __future__ import annotations

from pathlib import Path

from coordinator.expansion.plan_file import load_plan
from factory.bench.machine import StageRecorder, describe_machine
from factory.bench.reading.read import bench_read
from factory.bench.results import RenderBench
from factory.bench.simulation.render import bench_render
from factory.bench.workload import narrow
from factory.commands.other.bench_progress import SAMPLE_PLAN, progress_bar, temporary_folder
from factory.commands.other.bench_tables import show_read, show_render
from factory.dataset.reader import Dataset
from factory.runs.catalog import open_catalog
from factory.support.settings import scene_cache
from factory.support.terminal import print_result
from schemas.config import CameraConfig
from schemas.plan import Plan
from schemas.scene import read_scene
from schemas.storage.place import Place
from schemas.terms import RendererKind
from workers.render.choose import open_renderer


def render(
    scenes: tuple[str, ...] | None,
    frames: int,
    size: int,
    antialias: int,
    repeats: int,
    renderer: RendererKind,
    as_json: bool,
) -> None:
    """Executes `factory bench render`."""
    plan = narrow(load_plan(SAMPLE_PLAN), scenes or (), 1)
    machine, recorder = describe_machine(), StageRecorder()
    with progress_bar("render", len(plan.scenes)) as tell, temporary_folder() as folder:
        catalog = open_catalog(plan, folder, scene_cache())
        results = {}
        for name, entry in catalog.items():
            with open_renderer(renderer, timer=recorder) as opened:
                scene = read_scene(entry.path)
                results[name] = bench_render(scene, opened, recorder, CameraConfig(), frames, repeats, size, antialias)
                described = opened.description
            tell()
    report = RenderBench(
        machine=machine, renderer=described, size=size, antialias=antialias, repeats=repeats, scenes=results
    )
    print_result(report, as_json, show_render)


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
    """Executes `factory bench read`."""
    with temporary_folder() as folder:
        if root is None:
            root = made = folder / "sample"
            _make_sample(made, narrow(load_plan(SAMPLE_PLAN), scenes or (), 1), folder)
        chosen = Dataset(root).filter(**({"scene": scenes} if scenes else {}))
        report = bench_read(chosen, frames, repeats, workers, size, antialias)
    print_result(report, as_json, show_read)


def _make_sample(root: Path, plan: Plan, folder: Path) -> None:
    from factory.bench.workload import make_sample
    from workers.sim.context import SceneRenderer

    with progress_bar("sample", plan.episodes) as tell, SceneRenderer() as stage:
        make_sample(root, plan, open_catalog(plan, folder, scene_cache()), stage, tell)
