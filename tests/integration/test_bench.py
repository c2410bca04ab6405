"""The benchmarks on real work in a small room, those of `factory bench` and those of `tests.benchmarks`."""

from __future__ import annotations

import hashlib
import sys
from dataclasses import replace
from pathlib import Path

import pytest

from coordinator.archive.opening import open_archive
from coordinator.expansion.catalog import read_entry
from coordinator.ledger.opening import ledger_url_of
from coordinator.ledger.reading.audit import ledger_trouble
from factory.bench.machine import StageRecorder
from factory.bench.render import bench_render
from factory.bench.rollout import bench_rollout
from factory.bench.workload import BenchSample, first_attempts
from factory.dataset.reader import Dataset
from factory.runs.scene_packages import find_package
from schemas.config import CameraConfig, TaskConfig
from schemas.errors import WorldError
from schemas.job import Job
from schemas.scene import encode_scene
from schemas.terms import Recording
from tests.benchmarks.coordinator import bench_coordinator
from tests.benchmarks.dataset import bench_dataset
from tests.benchmarks.delivery import bench_delivery
from tests.benchmarks.memory import bench_memory
from tests.benchmarks.serve import bench_serve
from tests.benchmarks.synthetic import enlarge, make_synthetic
from tests.builders.bundle import job_for, parts_for
from tests.builders.dataset import make_dataset
from tests.builders.ledger import room_catalog, room_plan
from tests.builders.scene import box_room
from workers.render.choose import open_renderer
from workers.sim.context import SimulationContext

LOOP = ["start", "render", "read-back", "control", "physics", "png rgb", "depth", "png ids", "bundle", "route"]
LEAK_MIB = 20.0
"""Limit of the growth of memory, MiB. If each of the 16 compared episodes leaked one frame of 3.7 MiB, the growth would
be three times this limit."""


@pytest.fixture(scope="module")
def room(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("room") / "room.scene"
    path.write_bytes(encode_scene(box_room()))
    return path


def job_in(room: Path, **changes: object) -> Job:
    data = room.read_bytes()
    values = {
        "scene": "box_room",
        "scene_sha256": hashlib.sha256(data).hexdigest(),
        "scene_bytes": len(data),
        "category": "crate",
        "instruction": "Go to the crate.",
        "target_id": box_room().info.targets[0].target_id,
        "task": TaskConfig(),
    }
    return job_for(**values | changes)


@pytest.mark.gl
def test_rollout_is_timed_by_stage_and_compared_with_the_plain_pipeline(room: Path) -> None:
    watch, told = StageRecorder(), []
    with SimulationContext("gl", watch) as stage:
        found = bench_rollout([job_in(room)], read_entry(room), stage, watch, 2, 2, lambda: told.append(1))
    assert [cost.stage for cost in found.stages] == LOOP
    assert len(told) == 3
    assert (found.episodes, found.failed_attempts, found.wall.runs) == (1, 0, 2)
    assert found.frames_per_s_per_core == found.wall.median
    assert found.by_job.runs == 1
    # the stages cover the whole loop
    whole_ms = 1000 / found.frames_per_cpu_s
    assert sum(cost.cpu_ms.median for cost in found.stages) == pytest.approx(whole_ms, rel=0.1)
    assert [cost.stage for cost in found.delivery] == ["validate", "archive"]
    assert all(cost.cpu_ms.low > 0 for cost in found.delivery)
    assert found.kb_per_frame["rgb_front"] > found.kb_per_frame["actions_tokens.npy"] > 0
    assert found.plain is not None
    assert found.ratio == pytest.approx(found.wall.median / found.plain.frames_per_s)
    assert set(found.plain.stages) == {"physics", "getCameraImage", "Pillow RGB", "Pillow ids", "np.save depth"}


@pytest.mark.gl
def test_a_scene_without_a_successful_rollout_is_reported(room: Path) -> None:
    hasty = job_in(room, task=TaskConfig(max_steps=3))
    watch = StageRecorder()
    with (
        SimulationContext("gl", watch) as stage,
        pytest.raises(WorldError, match=r"none of 1 jobs in box_room succeeded.*timeout"),
    ):
        bench_rollout([hasty], read_entry(room), stage, watch, 1, 0, lambda: None)


@pytest.mark.gl
def test_rendering_and_readback_are_timed_separately() -> None:
    watch = StageRecorder()
    with open_renderer("gl", timer=watch) as renderer:
        found = bench_render(box_room(), renderer, watch, CameraConfig(), 3, 2)
    assert [cost.stage for cost in found.stages] == ["render", "read-back"]
    assert [cost.stage for cost in found.without_colour] == ["render", "read-back"]
    assert 0 < found.triangles_in_view <= found.triangles
    assert found.frames_per_s.runs == 2


# without garbage collection, frames kept alive by reference cycles count as leaks, so the test finds them
WITHOUT_GC = "import gc, runpy; gc.disable(); runpy.run_module('workers.sim.simulate', run_name='__main__')"
COMMAND = (sys.executable, "-c", WITHOUT_GC, "--renderer", "gl")


@pytest.mark.gl
def test_memory_is_measured_over_aborted_and_complete_episodes(room: Path) -> None:
    told: list[int] = []
    found = bench_memory([job_in(room)], {"box_room": read_entry(room)}, COMMAND, 20, lambda: told.append(1))
    assert len(told) == found.episodes == 20
    assert found.succeeded == 1
    assert found.frames > 19 * 5
    assert 0 < found.memory.start_mib < max(found.settled_mib, found.last_mib) <= found.memory.peak_mib
    assert found.last_mib - found.settled_mib < LEAK_MIB


@pytest.mark.gl
def test_no_memory_figure_is_reported_for_a_failed_simulation(room: Path) -> None:
    nowhere = replace(read_entry(room), path=room / "no folder")
    with pytest.raises(WorldError, match=r"simulation failed in scene .*Not a directory"):
        bench_memory([job_in(room)], {"box_room": nowhere}, COMMAND, 20, lambda: None)


def _archived_sample(root: Path, job: Job) -> BenchSample:
    parts = parts_for(job)
    with open_archive(root) as archive, archive.stage(1) as staged:
        staged.write(parts.write())
        path = archive.publish(staged, 1)
    assert isinstance(path, Path)
    return BenchSample(parts.meta.job, path)


def test_the_coordinator_is_timed_on_a_real_ledger_and_real_bundles(tmp_path: Path) -> None:
    sample = _archived_sample(tmp_path / "sample", job_for(1))
    (tmp_path / "bench").mkdir()
    found = bench_coordinator(
        room_plan(200),
        room_catalog(tmp_path),
        [sample],
        tmp_path / "bench",
        workers=4,
        sessions=8,
        bundle_bytes=3_000_000,
        repeats=1,
        pullers=2,
    )
    assert (found.jobs, found.workers) == (200, 4)
    assert found.cycles_per_s.median > 1
    assert found.validate_ms_per_frame.median > 0
    assert found.pullers == 2
    assert found.validated_frames_per_s.median > 0
    assert found.archive_mb_per_s.median > 0
    assert found.wire.cycles_per_s.median > 1
    assert found.wire.archived_per_s.median >= 0
    assert found.wire.coordinator_cpu_ms.low > 0.05  # includes at least the time of the COMMIT
    assert found.wire.workers_cpu_ms.low > 0.05
    assert (found.wire.session_load.sessions, found.wire.delivery_load.workers) == (8, 4)
    assert found.wire.delivery_load.claims > 0
    # the memory of a separate process, which never has a whole bundle in memory
    assert 30 < found.wire.delivery_load.memory.start_mib <= found.wire.delivery_load.memory.peak_mib
    # four bundles of the concurrent deliveries, and the bundles of earlier cycles
    assert len(list((tmp_path / "bench" / "episodes").iterdir())) >= 4


def test_the_delivery_benchmark_counts_centrally_validated_bundles_for_each_share_of_spot_checks(
    tmp_path: Path,
) -> None:
    plan, catalog, folder, told = room_plan(1), room_catalog(tmp_path), tmp_path / "bench", list[int]()
    sample = _archived_sample(tmp_path / "sample", first_attempts(plan, catalog, "room")[0])
    folder.mkdir()
    found = bench_delivery(
        plan,
        catalog,
        [sample],
        folder,
        episodes=6,
        workers=2,
        pullers=2,
        shares=(None, 0.0, 1.0),
        tell=lambda: told.append(1),
    )
    assert (found.episodes, found.frames, len(told)) == (6, 6 * 12, 3)
    assert [pace.spot_checks for pace in found.paces] == [None, 0.0, 1.0]
    assert [pace.validated for pace in found.paces] == [6, 0, 6]
    assert all(pace.cpu_s > 0 and pace.seconds > 0 for pace in found.paces)
    # every worker has delivered one bundle before the measurement
    assert [len(list((folder / f"run{number}" / "episodes").iterdir())) for number in range(3)] == [8, 8, 8]


@pytest.mark.gl
def test_a_generated_dataset_is_whole_and_is_measured(tmp_path: Path, recordings: dict[Recording, Path]) -> None:
    recorded = Dataset(recordings[Recording.STATES])
    plan = enlarge(recorded.meta.plan, 40)
    catalog = {name: find_package(recorded.root, name, sha256) for name, sha256 in recorded.meta.scenes.items()}
    samples = [BenchSample(episode.meta.job, Path(str(episode.path))) for episode in recorded]
    told: list[int] = []
    make_synthetic(tmp_path / "data", plan, catalog, samples, told.append)
    assert sum(told) == plan.episodes
    assert ledger_trouble(ledger_url_of(tmp_path / "data"), catalog) == ""
    assert len({episode.summary.content_digest for episode in Dataset(tmp_path / "data")}) == plan.episodes
    found = bench_dataset(tmp_path / "data", 10, 1.0)
    assert (found.episodes, found.verification.findings) == (plan.episodes, 0)
    assert found.gigabytes > 0
    assert min(found.reader.episodes_per_s, found.ledger.status_s, found.checkpoint.rewrite_s) > 0
    assert 0 < found.reader.opened.start_mib <= found.reader.memory.peak_mib


def test_the_web_page_of_a_dataset_is_measured(tmp_path):
    make_dataset(tmp_path / "data", 3)
    report = bench_serve(tmp_path / "data", repeats=2, tabs=3, seconds=0.2)
    assert report.episodes == 3
    assert all(cost.wall_ms.runs == 2 for cost in (report.first_page, report.first_frame, *report.table_page.values()))
    assert report.frames_per_s > 0
    assert report.first_page.wall_ms.low > 0
