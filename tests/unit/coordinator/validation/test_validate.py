"""Every violation that validation detects, one at a time, on the smallest valid bundle."""

from __future__ import annotations

import io
import json
import math
import zipfile
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from coordinator.validation.messages import Scope
from coordinator.validation.validate import sampled_frames, validate
from schemas.bundle import BundleReader
from schemas.config import DemonstrationConfig, TaskConfig
from schemas.encoding.container import ContainerWriter
from schemas.instruction.start_view import StartView
from schemas.job import Job
from schemas.terms import EndReason, ExpertName, Recording, Split, SuccessMeasure, Tier
from tests.builders.bundle import (
    FLOOR_ID,
    TARGET_ID,
    WALL_ID,
    BundleParts,
    bundle_bytes,
    former_parts,
    job_for,
    parts_for,
    short_task,
)
from tests.builders.dataset import chair

Breaker = Callable[[BundleParts], BundleParts]
FOOTPRINT_M = ((1.4, -0.2), (1.8, -0.2), (1.8, 0.2), (1.4, 0.2))
SHORT_BY_SURFACE = short_task().model_copy(update={"success": SuccessMeasure.SURFACE, "success_radius_m": 1.39})


def findings_of(parts: BundleParts, job: Job | None = None) -> str:
    return "\n".join(validate(BundleReader(io.BytesIO(parts.write())), job, (chair(),)))


def with_pose(parts: BundleParts, row: slice | int, column: int, value: float, add: bool = False) -> BundleParts:
    poses = parts.arrays.poses.copy()
    poses[row, column] = poses[row, column] + value if add else value
    return parts.with_arrays(poses=poses).measured()


def with_actions(parts: BundleParts, row: slice | int, column: int, value: float) -> BundleParts:
    actions = parts.arrays.actions_continuous.copy()
    actions[row, column] = value
    return parts.with_arrays(actions_continuous=actions)


def with_image(parts: BundleParts, t: int, which: int, rows: slice, value: float) -> BundleParts:
    frame = [image.copy() for image in parts.frames[t]]
    frame[which][rows] = value
    return parts.with_frame(t, tuple(frame))  # type: ignore[arg-type]


def drive_sideways(parts: BundleParts) -> BundleParts:
    poses = parts.arrays.poses.copy()
    poses[:, 1], poses[:, 0] = poses[:, 0], 0.03
    return parts.with_arrays(poses=poses).measured()


def freeze_images(parts: BundleParts) -> BundleParts:
    parts.frames[:] = [parts.frames[0]] * len(parts.frames)
    return parts


def freeze_colour(parts: BundleParts) -> BundleParts:
    parts.frames[:] = [(parts.frames[0][0], depth, ids) for _, depth, ids in parts.frames]
    return parts


JOB = {
    "another colour": (lambda p: p.with_job(colour="blue"), "job.colour: the bundle has 'blue'"),
    "another attempt": (lambda p: p.with_job(attempt=2), "job.attempt: the bundle has 2, the leased job has 1"),
    "another scene": (lambda p: p.with_job(scene_sha256="c" * 64), "job.scene_sha256"),
    "another target": (lambda p: p.with_job(target_id="chair_002"), "job.target_id"),
    "another run": (lambda p: p.with_job(run="other-1"), "job.run"),
}
TABLES = {
    "wrong id": (lambda p: p.with_meta(episode_id="ep_000009"), "episode_id is 'ep_000009'"),
    "wrong words": (lambda p: p.with_job(instruction="Fly."), "instruction is 'Fly.', but template train_01 gives"),
    "no such template": (lambda p: p.with_job(template_id="train_99"), "template_id 'train_99' does not exist"),
    "wrong pool": (lambda p: p.with_job(split=Split.TEST_PARAPHRASE_OOD), "does not belong to split"),
    "colourless": (lambda p: p.with_job(template_id="train_06", colour="unknown"), "the colour is unknown"),
    "unlisted target": (lambda p: p.with_meta(target_instance_id=99), "target_instance_id 99 is not in the instance"),
    "doubled id": (lambda p: p.with_meta(instances=p.meta.instances * 2), "is listed 2 times in the table"),
    "wrong category": (lambda p: p.with_job(category="sofa"), "the target is a chair in the instance table"),
    "wrong prim": (lambda p: p.with_meta(target_prim_path="/World/x"), "target_prim_path is '/World/x'"),
    "moved target": (lambda p: p.with_meta(target_centroid_m=(1.6, 0.01, 0.5)).measured(), "is 0.010000 m away from"),
}
ROLLOUT = {
    "length": (
        lambda p: p.with_rollout(trajectory_length_m=0.03),
        "trajectory_length_m is 0.030000, but the poses give 0.0225",
    ),
    "error": (lambda p: p.with_rollout(final_ne_m=0.5), "final_ne_m is 0.500000"),
    "3-d error": (lambda p: p.with_rollout(final_ne_3d_m=0.5), "final_ne_3d_m"),
    "least error": (lambda p: p.with_rollout(min_ne_m=0.5), "min_ne_m"),
    "start distance": (lambda p: p.with_rollout(spawn_dist_m=2.0), "spawn_dist_m"),
    "start pose": (lambda p: p.with_rollout(spawn_pose=(0.1, 0.0, 0.0)), "spawn_pose is 0.100000 m"),
    "start heading": (lambda p: p.with_rollout(spawn_pose=(0.0, 0.0, 0.2)), "and 0.200000 rad away from pose 0"),
    "draws": (lambda p: p.with_rollout(spawn_draws=9), "spawn_draws is 9, but the job allows at most 8"),
    "contacts": (lambda p: p.with_rollout(collision_count=13), "collision_count is 13, but the episode has 12 steps"),
    "visibility": (lambda p: p.with_rollout(steps_visible=3), "steps_visible 3, but 12 of 12 examined frames show"),
    "tier": (lambda p: p.with_job(tier=Tier.MID), "spawn distance 1.600 m is outside tier mid"),
    "no success": (lambda p: p.with_rollout(end_reason=EndReason.TIMEOUT), "only successes are archived"),
    "far away": (lambda p: with_pose(p, slice(None), 0, -0.05, add=True), "no success: 1.6275 m from the target"),
    "still rolling": (lambda p: with_pose(p, -1, 0, 0.001, add=True), "no success: 0.0600 m/s during the last 2 steps"),
    "token": (lambda p: p.with_arrays(actions_tokens=np.zeros((12, 2), np.int16)), "is not the nearest grid point"),
}
MOTION = {
    "teleport": (
        lambda p: with_pose(p, slice(5, None), 0, 0.02, add=True),
        "displacement in a step beyond the command",
    ),
    "backwards": (lambda p: with_pose(p, 4, 0, -0.02), "displacement backwards in a step"),
    "sideways": (drive_sideways, "displacement sideways in a step"),
    "turn": (lambda p: with_pose(p, slice(6, None), 6, 0.05), "turn in a step beyond the command"),
    "no quaternion": (lambda p: with_pose(p, 3, 3, 0.9), "deviation of the quaternion's norm from 1: 0.1 at step 3"),
    "flying": (lambda p: with_pose(p, 6, 2, 0.3), "height above the first frame: 0.3 m at step 6"),
    "jump start": (lambda p: with_actions(p, 0, 0, 0.5), "speeding up: 30 m/s2 at step 0, limit 2.5"),
    "emergency stop": (lambda p: with_actions(p, 7, 0, 0.0), "braking: 17.5 m/s2 at step 7, limit 8"),
    "jerk": (lambda p: with_actions(p, 2, 1, 1.0), "change of the yaw rate: 60 rad/s2 at step 2"),
}
FRAMES = {
    "frozen": (freeze_images, "depth_front is the same in frames 0 to 4"),
    "frozen colour": (lambda _: freeze_colour(parts_for(steps=40)), "rgb_front is the same in frames 0 to 21"),
    "strange id": (lambda p: with_image(p, 3, 2, slice(400, 401), 77), "frame 3: seg_front shows ids [77]"),
    "strange id below others": (lambda p: with_image(p, 3, 2, slice(400, 401), 5), "seg_front shows ids [5]"),
    "hollow": (lambda p: with_image(p, 3, 1, slice(400, 405), 0.0), "frame 3: depth and ids disagree"),
    "too deep": (lambda p: with_image(p, 3, 1, slice(400, 405), 31.0), "frame 3: depth_front: maximum 31.0"),
    "not a number": (lambda p: with_image(p, 3, 1, slice(400, 405), np.nan), "frame 3: depth_front: contains NaN"),
    "unseen": (lambda p: with_image(p, 3, 2, slice(280, 360), TARGET_ID - 5), "steps_visible 12, but 11 of 12"),
}
START = {
    "a second object that the instruction fits": (
        StartView(other_referents=(WALL_ID,)),
        "start: objects [2] are in view",
    ),
    "a target beside the heading": (StartView(within_rad=0.0), ""),
    "no other object of the category": (StartView(same_category=(WALL_ID,)), ""),
}


@pytest.mark.parametrize(("view", "text"), START.values(), ids=START)
def test_first_frame_is_checked_against_the_conditions_of_the_job(view: StartView, text: str) -> None:
    found = findings_of(parts_for(job_for(start_view=view)), job_for(start_view=view))
    assert found.startswith(text)
    assert bool(found) == bool(text)


def test_start_without_the_target_in_view_is_refused() -> None:
    job = job_for(start_view=StartView(same_category=(WALL_ID,), within_rad=math.radians(30)))
    found = findings_of(with_image(parts_for(job), 0, 2, slice(280, 360), FLOOR_ID), job)
    assert "start: the target is not in view\nstart: objects [2] of the target's category are in view" in found


def test_a_start_whose_target_is_too_far_from_the_heading_is_refused() -> None:
    job = job_for(start_view=StartView(within_rad=math.radians(30)))
    turned = parts_for(job)
    poses = turned.arrays.poses.copy()
    poses[:, 3], poses[:, 6] = math.cos(0.3), math.sin(0.3)  # quaternion of a heading of 0.6 rad
    assert "start: the target is 34.4 degrees from the heading, above 30" in findings_of(
        turned.with_arrays(poses=poses)
    )


def test_a_bundle_without_the_start_conditions_of_its_job_is_refused() -> None:
    leased = job_for(start_view=StartView(other_referents=(WALL_ID,)))
    assert "job.start_view: the bundle has None" in findings_of(parts_for(), leased)


def by_surface(parts: BundleParts, task: TaskConfig = SHORT_BY_SURFACE, **demonstration: object) -> BundleParts:
    """The smallest bundle, with success measured to a footprint whose edge is 0.2 m nearer than the centroid."""
    wanted = DemonstrationConfig.model_validate(demonstration)
    job = {"task": task, "demonstration": wanted, "tier": Tier.FAR}
    return parts.with_meta(target_footprint_m=FOOTPRINT_M).with_job(**job).measured().with_rollout(target_in_view=True)


SURFACE = {
    "no footprint": (lambda p: by_surface(p).with_meta(target_footprint_m=()), "chair_001 has no footprint"),
    "false error": (lambda p: by_surface(p).with_rollout(final_surface_m=0.5), "final_surface_m is 0.5, but the poses"),
    "no error": (lambda p: by_surface(p).with_rollout(spawn_surface_m=None), "spawn_surface_m is None, but the poses"),
    "too far": (
        lambda p: by_surface(p, SHORT_BY_SURFACE.model_copy(update={"success_radius_m": 0.1})),
        "no success: 1.37",
    ),
    "tier": (lambda p: by_surface(p).with_job(tier=Tier.NEAR), "spawn distance 1.400 m is outside tier near"),
    "contact": (
        lambda p: by_surface(p, max_contact_steps=2).with_rollout(collision_count=3),
        "collision_count is 3, but the plan allows at most 2",
    ),
    "target lost": (
        lambda p: with_image(by_surface(p, target_in_view=True), 11, 2, slice(280, 360), TARGET_ID - 5),
        "the last frame shows 0 pixels of the target, the plan requires 32",
    ),
    "false view": (lambda p: by_surface(p).with_rollout(target_in_view=False), "target_in_view False, but the last"),
}


def test_an_episode_with_the_surface_measure_has_no_findings_although_the_centroid_is_far() -> None:
    parts = by_surface(parts_for(), max_contact_steps=0, target_in_view=True)
    target = chair().model_copy(update={"footprint_m": FOOTPRINT_M})
    assert validate(BundleReader(io.BytesIO(parts.write())), None, (target,)) == []
    assert any(
        "target_footprint_m" in line for line in validate(BundleReader(io.BytesIO(parts.write())), None, (chair(),))
    )


@pytest.mark.parametrize(("breaker", "text"), SURFACE.values(), ids=SURFACE)
def test_false_claims_about_contact_view_and_the_surface_measure_are_found(breaker: Breaker, text: str) -> None:
    assert text in findings_of(breaker(parts_for()))


def test_smallest_bundle_has_no_findings() -> None:
    assert findings_of(parts_for(), job_for()) == ""


def test_bundle_of_format_1_with_float32_poses_has_no_findings() -> None:
    assert findings_of(former_parts()) == ""


def test_rounded_poses_are_refused_in_the_present_format() -> None:
    assert "poses.npy has float32; bundles of format 2 have float64" in findings_of(former_parts().with_meta(format=2))


def states(expert: ExpertName = ExpertName.PROPORTIONAL) -> BundleParts:
    return parts_for(job_for(record=Recording.STATES, expert=expert))


STATES = {
    "frames in a states recording": (
        lambda: with_members_of(parts_for(), states()),
        "the bundle has frames, but its job records states",
    ),
    "no frames": (
        lambda: with_members_of(states(), parts_for()),
        "the bundle lacks frames, but its job records frames",
    ),
    "instance table": (
        lambda: states().with_meta(instances=parts_for().meta.instances).write(),
        "a states recording has an instance table",
    ),
    "uncounted visibility": (
        lambda: states().with_rollout(steps_visible=None).write(),
        "steps_visible is None, not a number, in a recording of states by the proportional expert",
    ),
    "too much visibility": (
        lambda: states().with_rollout(steps_visible=13).write(),
        "steps_visible is 13, but the episode has 12 steps",
    ),
    "missing digest": (
        lambda: edited(states(), lambda meta: meta.update(frame_digests=meta["frame_digests"][1:])),
        "2 frame digests for 3 frames",
    ),
    "other digest": (
        lambda: edited(states(), lambda meta: meta["frame_digests"].__setitem__(0, "0" * 32)),
        "content digest",
    ),
    "impossible motion": (lambda: with_pose(states(), 6, 2, 0.3).write(), "height above the first frame: 0.3 m"),
}


def members_of(data: bytes) -> dict[str, bytes]:
    with zipfile.ZipFile(io.BytesIO(data)) as found:
        return {name: found.read(name) for name in found.namelist()}


def pack(members: dict[str, bytes]) -> bytes:
    buffer = io.BytesIO()
    with ContainerWriter(buffer) as out:
        for name, data in members.items():
            out.add(name, data)
    return buffer.getvalue()


def with_members_of(parts: BundleParts, other: BundleParts) -> bytes:
    """Returns the bundle of `parts` with the metadata of `other`."""
    return pack(members_of(parts.write()) | {"meta.json": members_of(other.write())["meta.json"]})


def edited(parts: BundleParts, edit: Callable[[dict[str, Any]], object]) -> bytes:
    members = members_of(parts.write())
    meta = json.loads(members["meta.json"])
    edit(meta)
    return pack(members | {"meta.json": json.dumps(meta).encode()})


def test_smallest_states_recording_has_no_findings_and_no_frames() -> None:
    data = states().write()
    assert validate(BundleReader(io.BytesIO(data)), job_for(record=Recording.STATES), (chair(),)) == []
    assert not BundleReader(io.BytesIO(data)).has_frames
    assert len(data) < 10_000


@pytest.mark.parametrize(("made", "text"), STATES.values(), ids=STATES)
def test_contradiction_in_a_states_recording_is_found(made: Callable[[], bytes], text: str) -> None:
    found = validate(BundleReader(io.BytesIO(made())), None, (chair(),))
    assert any(text in finding for finding in found)


@pytest.mark.parametrize(("breaker", "text"), JOB.values(), ids=JOB)
def test_bundle_of_another_job_is_refused(breaker: Breaker, text: str) -> None:
    assert text in findings_of(breaker(parts_for()), job_for())


@pytest.mark.parametrize(("breaker", "text"), TABLES.values(), ids=TABLES)
def test_contradiction_in_the_metadata_is_found(breaker: Breaker, text: str) -> None:
    assert text in findings_of(breaker(parts_for()))


@pytest.mark.parametrize(("breaker", "text"), ROLLOUT.values(), ids=ROLLOUT)
def test_false_statistics_are_found(breaker: Breaker, text: str) -> None:
    assert text in findings_of(breaker(parts_for()))


@pytest.mark.parametrize(("breaker", "text"), MOTION.values(), ids=MOTION)
def test_impossible_motion_is_found(breaker: Breaker, text: str) -> None:
    assert text in findings_of(breaker(parts_for()))


@pytest.mark.parametrize(("breaker", "text"), FRAMES.values(), ids=FRAMES)
def test_impossible_frames_are_found(breaker: Breaker, text: str) -> None:
    assert text in findings_of(breaker(parts_for()))


def test_all_violations_are_returned_at_once() -> None:
    broken = with_pose(parts_for().with_job(instruction="Fly."), 6, 2, 0.3).with_rollout(steps_visible=1)
    found = findings_of(broken, job_for(2))
    assert all(text in found for text in ("job.index", "'Fly.'", "height above", "steps_visible 1"))


def test_many_bad_frames_are_counted_not_listed() -> None:
    parts = parts_for()
    for t in range(12):
        for which in (1, 2):
            parts = with_image(parts, t, which, slice(400, 405), 0.0 if which == 1 else 77)
    found = validate(BundleReader(io.BytesIO(parts.write())))
    assert any(text == "and 4 more findings about frames" for text in found)


def test_a_sample_has_both_end_frames_and_every_eighth_frame_from_an_offset_given_by_the_digest() -> None:
    samples = set()
    for first in range(8):
        parts = parts_for()
        meta = parts.meta.model_copy(update={"content_digest": f"{first:032x}"})
        steps = sampled_frames(meta)
        assert steps == sorted({0, first, *range(first, 12, 8), 11})
        samples |= set(steps)
    assert samples == set(range(12))


def test_only_the_frames_of_a_sample_are_decoded_and_each_of_them_is_checked() -> None:
    sound = BundleReader(io.BytesIO(bundle_bytes()))
    steps, seen = sampled_frames(sound.meta), list[int]()
    assert validate(sound, on_frame=seen.append, scope=Scope.SAMPLE) == []
    assert seen == steps
    for t in steps:
        broken = BundleReader(io.BytesIO(with_image(parts_for(), t, 2, slice(400, 405), 77).write()))
        if t in sampled_frames(broken.meta):
            assert f"frame {t}: seg_front shows ids [77]" in "\n".join(validate(broken, scope=Scope.SAMPLE))


@pytest.mark.parametrize("said", [0, 1])
def test_a_visibility_that_the_sampled_frames_contradict_is_refused(said: int) -> None:
    broken = BundleReader(io.BytesIO(parts_for().with_rollout(steps_visible=said).write()))
    assert f"steps_visible {said}, but" in "\n".join(validate(broken, scope=Scope.SAMPLE))


def test_progress_is_reported_for_every_frame() -> None:
    seen: list[int] = []
    validate(BundleReader(io.BytesIO(bundle_bytes())), on_frame=seen.append)
    assert seen == list(range(12))


def test_a_robot_that_is_held_in_place_and_reports_contact_passes_motion_validation() -> None:
    parts = parts_for()
    poses = np.repeat(parts.arrays.poses[:1], 12, axis=0)
    poses[:, 0] = 0.0225
    held = parts.with_arrays(poses=poses).measured().with_rollout(collision_count=12)
    assert findings_of(held) == ""
