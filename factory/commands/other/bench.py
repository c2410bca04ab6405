"""`factory bench`: measures collection, memory and coordinator on this machine. Needs PyBullet."""

from __future__ import annotations

import os

from coordinator.expansion.plan_file import load_plan
from factory.bench.machine import StageRecorder, describe_machine
from factory.bench.results import CollectBench, RolloutBench
from factory.bench.service.coordinator import bench_coordinator
from factory.bench.simulation.collect import bench_collect
from factory.bench.simulation.memory import bench_memory
from factory.bench.simulation.rollout import bench_rollout
from factory.bench.workload import first_attempts, make_sample, narrow
from factory.commands.common.plan_changes import shrunk_plan
from factory.commands.other.bench_progress import SAMPLE_PLAN, progress_bar, temporary_folder
from factory.commands.other.bench_tables import show_collect, show_coordinator, show_memory, show_rollout
from factory.runs.catalog import open_catalog
from factory.support.settings import scene_cache
from factory.support.terminal import print_result
from schemas.terms import ExpertName, Recording, RendererKind
from workers.client.settings import WorkerSettings
from workers.sim.context import SceneRenderer

_MEMORY_JOBS = 25
"""Number of different jobs of each scene; they are repeated in turn."""


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
    """Executes `factory bench rollout`."""
    plan = shrunk_plan(narrow(load_plan(plan_name), scenes or (), episodes), {"record": record})
    machine, recorder = describe_machine(), StageRecorder()
    with progress_bar("rollout", len(plan.scenes) * (1 + episodes * repeats)) as tell, temporary_folder() as folder:
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
    """Executes `factory bench collect`."""
    base = shrunk_plan(load_plan(plan_name), {"scenes": scenes, "episodes": episodes})
    variants = {
        f"{record}, {expert}": shrunk_plan(base, {"record": record, "expert": expert})
        for record in records or (base.record,)
        for expert in experts or (base.expert,)
    }
    machine, processes = describe_machine(), workers or os.cpu_count() or 1
    with progress_bar("collect", len(variants) * repeats) as tell, temporary_folder() as folder:
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


def memory(scenes: tuple[str, ...] | None, episodes: int, renderer: RendererKind, as_json: bool) -> None:
    """Executes `factory bench memory`."""
    plan = narrow(load_plan("paper"), scenes or (), _MEMORY_JOBS)
    with progress_bar("memory", episodes) as tell, temporary_folder() as folder:
        catalog = open_catalog(plan, folder, scene_cache())
        turns = zip(*(first_attempts(plan, catalog, name) for name in catalog), strict=True)
        jobs = [job for turn in turns for job in turn]
        command = WorkerSettings(connect=(), renderer=renderer).simulation_command
        report = bench_memory(jobs, catalog, command, episodes, tell)
    print_result(report, as_json, show_memory)


def coordinator(
    jobs: int, workers: int, sessions: int, bundle_mb: int, pullers: int, repeats: int, as_json: bool
) -> None:
    """Executes `factory bench coordinator`."""
    sample_plan = narrow(load_plan(SAMPLE_PLAN), ("office",), 2)
    part = sample_plan.scenes[0].model_copy(update={"episodes": jobs})
    plan = load_plan("paper").model_copy(update={"scenes": (part,)})
    with progress_bar("coordinator", 2) as tell, temporary_folder() as folder:
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
