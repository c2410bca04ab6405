"""`factory bench sessions`: simulates the sessions of thousands of workers against one coordinator."""

from __future__ import annotations

from coordinator.expansion.plan_file import load_plan
from factory.bench.results import SessionsBench
from factory.bench.service.sessions import SessionsLoad, bench_sessions
from factory.bench.workload import make_sample, narrow
from factory.commands.common.plan_changes import shrunk_plan
from factory.commands.other.bench_progress import SAMPLE_PLAN, progress_bar, temporary_folder
from factory.runs.catalog import open_catalog
from factory.support.settings import scene_cache
from factory.support.terminal import print_result, print_table
from schemas.bundle import BundleReader
from workers.sim.context import SceneRenderer


def sessions(sessions: int, cores: int, episode_s: float, lease_s: float, seconds: float, as_json: bool) -> None:
    """Executes `factory bench sessions`."""
    plan = shrunk_plan(narrow(load_plan(SAMPLE_PLAN), ("office",), 2), {"record": "states"})
    with progress_bar("sample", plan.episodes) as tell, temporary_folder() as folder:
        catalog = open_catalog(plan, folder, scene_cache())
        with SceneRenderer() as stage:
            samples = make_sample(folder / "sample", plan, catalog, stage, tell)
        with samples[0].path.open("rb") as file, BundleReader(file) as bundle:
            meta = bundle.meta
        load = SessionsLoad(sessions, cores, episode_s, lease_s, seconds)
        report = bench_sessions(plan, catalog, meta, folder, load)
    print_result(report, as_json, _show)


def _show(report: SessionsBench) -> None:
    title = (
        f"{report.sessions} sessions of {report.cores} cores, an attempt every {report.episode_s:g} s, lease "
        f"{report.lease_s:g} s, {report.seconds:g} s simulated"
    )
    rows = [
        (verb, *(f"{value:.0f}" for value in (load.per_s, load.received_bytes, load.sent_bytes, load.cpu_us)))
        for verb, load in report.verbs.items()
    ]
    print_table(title, ("request", "per second", "bytes", "bytes of the reply", "CPU us"), rows)
    totals = [
        ("archived episodes per second", f"{report.episodes_per_s:.0f}"),
        ("commits per second, one fsync each", f"{report.commits_per_s:.0f}"),
        ("CPU time of a commit, us", f"{report.commit_us:.0f}"),
        ("ledger, bytes per episode", f"{report.ledger_bytes_per_episode:.0f}"),
        ("cores of the coordinator, without network", f"{report.coordinator_cores:.2f}"),
    ]
    print_table("\nin total", ("quantity", "value"), totals)
