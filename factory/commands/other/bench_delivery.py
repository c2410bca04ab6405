"""`factory bench delivery`: measures how many valid bundles a coordinator archives."""

from __future__ import annotations

from coordinator.expansion.plan_file import load_plan
from factory.bench.results import DeliveryBench
from factory.bench.service.delivery import bench_delivery
from factory.bench.workload import make_sample, narrow
from factory.commands.common.plan_changes import shrunk_plan
from factory.commands.other.bench_progress import SAMPLE_PLAN, progress_bar, temporary_folder
from factory.runs.catalog import open_catalog
from factory.support.settings import scene_cache
from factory.support.terminal import print_result, print_table
from workers.sim.context import SceneRenderer


def delivery(episodes: int, workers: int, pullers: int, spot_checks: float, record: str | None, as_json: bool) -> None:
    """Executes `factory bench delivery`."""
    plan = shrunk_plan(narrow(load_plan(SAMPLE_PLAN), ("office",), 2), {"record": record})
    with progress_bar("delivery", plan.episodes + 2) as tell, temporary_folder() as folder:
        catalog = open_catalog(plan, folder, scene_cache())
        with SceneRenderer() as stage:
            samples = make_sample(folder / "sample", plan, catalog, stage, tell)
        report = bench_delivery(
            plan,
            catalog,
            samples,
            folder,
            episodes=episodes,
            workers=workers,
            pullers=pullers,
            shares=(None, spot_checks),
            tell=tell,
        )
    print_result(report, as_json, _show)


def _show(report: DeliveryBench) -> None:
    title = (
        f"{report.episodes} {report.record} episodes of {report.mb_per_episode:.2f} MB, {report.frames} steps, "
        f"{report.workers} simulated workers"
    )
    rows = [
        (
            *("all" if pace.spot_checks is None else f"{pace.spot_checks:g}", pace.validated, pace.pullers),
            *(f"{pace.frames_per_cpu_s:.0f}", f"{pace.episodes_per_cpu_s:.1f}"),
            *(f"{pace.frames_per_s:.0f}", f"{pace.episodes_per_s:.1f}"),
        )
        for pace in report.paces
    ]
    columns = ("share", "validated", "pullers", "frames/CPU s", "episodes/CPU s", "frames/s", "episodes/s")
    print_table(title, columns, rows)
