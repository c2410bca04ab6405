"""`factory bench dataset`: generates and measures a large dataset of states."""

from __future__ import annotations

import time
from pathlib import Path

from coordinator.expansion.plan_file import load_plan
from factory.bench.reading.dataset import bench_dataset
from factory.bench.reading.synthetic import make_synthetic
from factory.bench.workload import enlarge, make_sample, narrow
from factory.commands.common.plan_changes import shrunk_plan
from factory.commands.other.bench_progress import SAMPLE_PLAN, temporary_folder
from factory.commands.other.bench_tables import show_dataset
from factory.runs.catalog import open_catalog
from factory.support.settings import scene_cache
from factory.support.terminal import Bars, print_result
from workers.sim.context import SceneRenderer


def dataset(episodes: int, reads: int, out: Path | None, as_json: bool) -> None:
    """Executes `factory bench dataset`."""
    sample_plan = shrunk_plan(narrow(load_plan(SAMPLE_PLAN), (), 2), {"record": "states"})
    plan = shrunk_plan(enlarge(load_plan("paper"), episodes), {"record": "states", "episodes": episodes})
    with temporary_folder() as folder, Bars(refresh_per_second=1) as bar:
        catalog = open_catalog(sample_plan, folder, scene_cache())
        with SceneRenderer() as stage:
            task = bar.add_task("bench sample", total=sample_plan.episodes)
            samples = make_sample(folder / "sample", sample_plan, catalog, stage, lambda: bar.advance(task))
        task = bar.add_task("bench dataset", total=episodes)
        start_s = time.perf_counter()
        data = folder / "data" if out is None else out
        make_synthetic(data, plan, catalog, samples, lambda count: bar.advance(task, count))
        report = bench_dataset(data, reads, time.perf_counter() - start_s)
    print_result(report, as_json, show_dataset)
