"""The parts of the benchmarks that need no simulation: stopwatch, spreads, choice of jobs, machine description."""

from __future__ import annotations

import mmap
import subprocess
import sys
import time

import numpy as np
import pytest

from coordinator.expansion.plan_file import load_plan
from factory.bench.machine import (
    StageRecorder,
    describe_machine,
    measure_memory,
    reset_peak,
    resident_mib,
    stage_costs,
)
from factory.bench.read import bench_read
from factory.bench.render import poses_in
from factory.bench.results import RolloutBench, Spread
from factory.bench.tables import show_rollout
from factory.bench.workload import narrow
from factory.dataset.reader import Dataset
from schemas.errors import UsageError
from tests.builders.dataset import make_dataset
from tests.builders.scene import box_room


def test_a_stopwatch_gives_every_stage_the_time_since_the_previous_stage() -> None:
    watch = StageRecorder()
    started = time.perf_counter()
    watch.start()
    for stage in ("slow", "quick", "slow"):
        if stage == "slow":
            time.sleep(0.02)
        watch(stage)
    times = watch.take()
    assert list(times) == ["slow", "quick"]
    assert times["slow"][0] >= 0.04
    assert times["slow"][0] + times["quick"][0] <= time.perf_counter() - started
    assert times["slow"][1] < times["slow"][0]  # sleeping uses no CPU time
    watch.start()
    assert watch.take() == {}


def test_costs_are_milliseconds_per_frame_with_their_spread_over_the_runs() -> None:
    (cost,) = stage_costs([(10, {"render": (1.0, 0.5)}), (10, {"render": (3.0, 0.6)}), (10, {"render": (2.0, 0.7)})])
    assert (cost.stage, cost.wall_ms.median, cost.wall_ms.low, cost.wall_ms.high) == ("render", 200.0, 100.0, 300.0)
    assert cost.cpu_ms.median == pytest.approx(60.0)


def test_a_spread_has_the_median_and_both_ends() -> None:
    assert Spread.of([3.0, 1.0, 2.0]) == Spread(median=2.0, low=1.0, high=3.0, runs=3)


def test_a_plan_is_narrowed_to_scenes_with_the_same_number_of_episodes_each() -> None:
    plan = narrow(load_plan("paper"), ("hospital", "office"), 4)
    assert [(scene.name, scene.episodes) for scene in plan.scenes] == [("hospital", 4), ("office", 4)]
    assert len(narrow(load_plan("demo"), (), 1).scenes) == 4


def test_the_table_of_a_rollout_benchmark_names_the_screening_of_its_starts(
    capsys: pytest.CaptureFixture[str],
) -> None:
    screening = load_plan("paper").screening
    report = RolloutBench(
        machine=describe_machine(), renderer="none", plan="paper", screening=screening, repeats=3, scenes={}
    )
    show_rollout(report)
    shown = " ".join(capsys.readouterr().out.split())
    assert "3 runs of the same jobs of plan paper, screening none, office sight" in shown
    assert report.model_dump(mode="json")["screening"] == "none, office sight"
    assert load_plan("demo").screening == "foreseen"


def test_a_scene_or_number_of_episodes_that_the_plan_does_not_have_is_refused() -> None:
    with pytest.raises(UsageError, match="no scene 'garage'"):
        narrow(load_plan("paper"), ("garage",), 1)
    with pytest.raises(UsageError, match=r"fewer episodes \(52 of hospital\)"):
        narrow(load_plan("paper"), ("hospital", "office"), 53)


def test_the_poses_to_render_are_reproducible_surveyed_points() -> None:
    scene = box_room()
    poses = poses_in(scene, 20)
    assert poses == poses_in(scene, 20)
    surveyed = {tuple(point) for point in scene.spawns.astype(np.float64).tolist()}
    assert {(pose.x, pose.y) for pose in poses} <= surveyed


def test_a_memory_peak_can_be_reset() -> None:
    held = mmap.mmap(-1, 200 << 20)
    held.write(b"x" * len(held))
    held.close()
    before = measure_memory(resident_mib())
    reset_peak()
    after = measure_memory(resident_mib())
    assert after.peak_mib < before.peak_mib - 100
    assert after.peak_mib >= after.end_mib - 1


def test_the_machine_is_named_and_its_memory_is_that_of_this_process() -> None:
    machine = describe_machine()
    assert machine.cpu
    assert machine.cores >= 1
    # a new mapping: malloc may return pages that this process used before
    with mmap.mmap(-1, 40 << 20) as held:
        before = resident_mib()
        held[:: mmap.PAGESIZE] = b"x" * (len(held) // mmap.PAGESIZE)
        memory = measure_memory(before)
    assert memory.end_mib - memory.start_mib == pytest.approx(40, abs=8)
    assert memory.peak_mib >= memory.end_mib - 1


def test_reading_is_measured_on_the_existing_episodes(tmp_path) -> None:
    make_dataset(tmp_path / "data", episodes=2)
    report = bench_read(Dataset(tmp_path / "data"), frames=4, repeats=2, workers=0)
    assert (report.episodes, report.frames, report.random_frames_per_s.runs) == (2, 4, 2)
    assert set(report.by_image) == {"rgb", "depth", "ids"}
    assert all(found.median > 0 for found in report.by_image.values())


def test_frames_are_measured_without_the_packages_of_a_simulation() -> None:
    modules = "{'pybullet', 'zenoh', 'sqlalchemy'}"
    needed = ", ".join(f"factory.bench.{name}" for name in ("read", "render", "tables", "workload"))
    code = f"import sys, factory.runs.catalog, {needed}; print({modules} & {{*sys.modules}})"
    command = [sys.executable, "-P", "-c", code]
    assert subprocess.run(command, capture_output=True, text=True, check=True).stdout == "set()\n"
