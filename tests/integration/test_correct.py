"""Corrections by command: a round of a user's class, its labels, its resumption, and policies that fail."""

from __future__ import annotations

import math
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest

from factory.dataset.reader import Dataset, Episode
from schemas.measure import Goal
from schemas.support.child import child_environment
from schemas.support.geometry import planar_states
from schemas.terms import Driver
from workers.experts.planner import PlannerExpert
from workers.geometry.grid import Grid
from workers.geometry.pose import Pose

POLICIES = '''
import time
class Wanders:
    """Drives a bend, and stands still for a while in the wrong place."""
    def reset(self, instruction, info): assert instruction and info.control_hz == 60
    def act(self, observation):
        assert observation["rgb"].shape == (640, 640, 3) and observation["state"].shape == (5,)
        return [[0.6, 0.2]] * 6 if observation["step"] % 150 < 90 else [[0.0, 0.0]] * 6
class Hangs(Wanders):
    def act(self, observation):
        if observation["step"] > 10: time.sleep(1000)
        return [0.2, 0.0]
'''
EPISODES = 4


def run(folder: Path, *arguments: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-P", "-m", "factory", *arguments],
        cwd=folder,
        env=child_environment(os.environ),
        capture_output=True,
        text=True,
        timeout=540,
        check=False,
    )


def corrected(folder: Path, policy: str, out: str, *more: str) -> tuple[str, ...]:
    options = ("--episodes", str(EPISODES), "--workers", "1")
    return ("correct", str(folder / "base"), "--policy", policy, "-o", str(folder / out), *options, *more)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("corrections")
    (folder / "wandering.py").write_text(POLICIES)
    made = run(
        folder, "run", "demo", "--scene", "office", "--expert", "planner", "--record", "states", "--episodes", "4",
        "--gate", "skip", "--workers", "2", "--out", "base",
    )  # fmt: skip
    assert made.returncode == 0, made.stderr
    done = run(folder, *corrected(folder, "wandering:Wanders", "round"))
    assert done.returncode == 0, done.stderr
    assert "next:    factory train bc" in done.stdout
    return folder


def label_again(episode: Episode, t: int) -> np.ndarray | None:
    """Returns the planner's action at the pose of a step, computed without the drive."""
    meta = episode.meta
    scene = episode.package.geometry()
    target = scene.info.target(meta.job.target_id)
    planner = PlannerExpert(meta.job)
    planner.begin(Pose.of(episode.poses[0]), Grid.from_scene(scene), target)
    pose = Pose.of(episode.poses[t])

    class Seen:
        target_mask = obstacle_near = None
        distance_m = Goal.of(target, meta.job.task).distance(pose.x, pose.y)
        bearing_rad = math.remainder(
            math.atan2(target.centroid_m[1] - pose.y, target.centroid_m[0] - pose.x) - pose.yaw, 2 * math.pi
        )

    Seen.pose = pose
    speed = 0.0
    if t:
        speed = math.dist(episode.poses[t - 1, :2], episode.poses[t, :2]) * meta.job.task.control_hz
    twist = planner.action_at(Seen, speed)
    return None if twist is None else np.array(twist, np.float32)


def test_every_episode_ends_at_its_target_and_says_who_acted(folder: Path) -> None:
    dataset, drivers, routes = Dataset(folder / "round"), set(), []
    assert len(dataset) == EPISODES
    for episode in dataset:
        with episode:
            corrections = episode.corrections
            assert corrections is not None
            assert episode.meta.format == 4
            assert episode.meta.rollout.end_reason == "success"
            drivers |= {Driver(by) for by in corrections.drivers}
            is_labelled = np.isfinite(corrections.expert_actions).all(axis=1)
            assert not is_labelled[np.arange(len(is_labelled)) % 6 != 0].any()
            assert is_labelled[::6].mean() > 0.9
            assert corrections.route_m[0] < 0.1, "the route begins at the start"
            routes.append(corrections.route_m.max())
    assert 0.1 < max(routes) < 10, "policies and disturbances leave the route"
    assert {Driver.POLICY, Driver.EXPERT} <= drivers
    assert {episode.summary.split for episode in dataset} == {"train_id"}


def test_labels_equal_the_actions_of_the_planner_at_the_same_states(folder: Path) -> None:
    compared = 0
    for episode in Dataset(folder / "round"):
        with episode:
            assert episode.corrections is not None
            for t in range(0, len(episode), 30):
                label, again = episode.corrections.expert_actions[t], label_again(episode, t)
                assert np.isnan(label).all() if again is None else np.array_equal(label, again), (episode.episode_id, t)
                compared += again is not None
    assert compared > 20


def test_the_planner_takes_over_where_the_policy_stands_still_in_the_wrong_place(folder: Path) -> None:
    for episode in Dataset(folder / "round"):
        with episode:
            assert episode.corrections is not None
            speed = planar_states(episode.poses, 60)[:, 3]
            by_policy = episode.corrections.drivers == Driver.POLICY
            still = by_policy & (speed < 0.005)
            longest = max((len(run) for run in "".join("x" if s else " " for s in still).split()), default=0)
            assert longest <= 0.8 * 60 + 12, "0.8 s, one label period, and braking"


@pytest.mark.slow
def test_a_round_is_valid_and_can_be_exported_and_rendered(folder: Path) -> None:
    assert run(folder, "verify", "round", "--deep").returncode == 0
    rendered = run(folder, "render", "round", "-o", "frames", "--workers", "2")
    assert rendered.returncode == 0, rendered.stderr
    for one, other in zip(Dataset(folder / "round"), Dataset(folder / "frames"), strict=True):
        with one, other:
            assert one.states_digest == other.states_digest
            assert one.corrections is not None
            assert other.corrections is not None
            assert np.array_equal(one.corrections.drivers, other.corrections.drivers)


@pytest.mark.slow
def test_an_interrupted_round_has_the_digest_of_an_undisturbed_one(folder: Path) -> None:
    command = [sys.executable, "-P", "-m", "factory", *corrected(folder, "wandering:Wanders", "again")]
    for _ in range(2):
        process = subprocess.Popen(
            command, cwd=folder, env=child_environment(os.environ), stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL
        )
        before, deadline = len(list((folder / "again").rglob("ep_*.zip"))), time.monotonic() + 200
        while time.monotonic() < deadline and process.poll() is None:
            if len(list((folder / "again").rglob("ep_*.zip"))) > before:
                break
            time.sleep(0.05)
        process.send_signal(signal.SIGINT)
        process.wait(60)
    done = run(folder, *corrected(folder, "wandering:Wanders", "again"))
    assert done.returncode == 0, done.stderr
    assert Dataset(folder / "again").digest == Dataset(folder / "round").digest


@pytest.mark.slow
def test_a_policy_that_hangs_fails_its_episodes_with_a_reason_and_the_round_ends(folder: Path) -> None:
    done = run(folder, *corrected(folder, "wandering:Hangs", "hung", "--act-timeout", "1", "--episodes", "1"))
    assert done.returncode == 1, done.stdout + done.stderr
    listed = run(folder, "jobs", "list", "hung")
    assert "policy_hung: act exceeded 1 s" in " ".join(listed.stdout.split()), listed.stdout


@pytest.mark.slow
def test_an_export_to_lerobot_says_in_which_frames_the_planner_acted(folder: Path) -> None:
    done = run(folder, "export", "round", "--to", "lerobot", "--fps", "10", "-o", "lerobot")
    assert done.returncode == 0, done.stderr
    table = pq.read_table(next((folder / "lerobot" / "data").rglob("*.parquet")))
    drivers = [episode.corrections.drivers[::6] for episode in Dataset(folder / "round") if episode.corrections]
    assert table["intervention"].to_pylist() == (np.concatenate(drivers) == Driver.EXPERT).tolist()


def test_another_policy_and_a_policy_with_nothing_to_correct_are_refused(folder: Path) -> None:
    source = folder / "wandering.py"
    source.write_text(POLICIES.replace("0.6, 0.2", "0.5, 0.2"))
    changed = run(folder, *corrected(folder, "wandering:Wanders", "round"))
    source.write_text(POLICIES)
    assert changed.returncode == 2
    assert "give another -o, and --round 2 for new starts" in " ".join(changed.stderr.split())
    planner = run(folder, *corrected(folder, "planner", "other"))
    assert planner.returncode == 2
    assert "nothing to correct" in planner.stderr
    replayed = run(folder, "replay", "round", "ep_000001")
    assert replayed.returncode == 2
    assert "was driven by policy wandering:Wanders" in " ".join(replayed.stderr.split())
