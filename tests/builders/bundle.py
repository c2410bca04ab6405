"""Builds the smallest bundle that passes validation: a short successful drive with synthetic images.

Tests change one part of it to get a bundle that validation refuses. Simulates no physics and renders nothing.
"""

from __future__ import annotations

import dataclasses
import functools
import io
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from datetime import UTC, datetime
from typing import Any

import numpy as np
from numpy.typing import NDArray

from schemas.bundle import BundleWriter, EpisodeArrays
from schemas.config import CameraConfig, ExpertConfig, RobotConfig, SpawnConfig, TaskConfig
from schemas.encoding.arrays import ArraySpec
from schemas.encoding.image_sizes import FRAME_SIZE_PX
from schemas.episode import EpisodeMeta, Fingerprint, Provenance, Rollout, format_of
from schemas.instruction.templates import instruction
from schemas.job import Job
from schemas.measure import measure_track
from schemas.rig.measurements import Arrays, measurements_of
from schemas.scene import Instance
from schemas.terms import EndReason, ExpertName, Recording, Split, Tier
from schemas.tokens import tokens_of

Frame = tuple[NDArray[np.uint8], NDArray[np.float32], NDArray[np.uint16]]

GOAL_M = (1.6, 0.0, 0.5)
"""Centroid of the target, metres."""
RADIUS_M = 1.58
"""Radius of the success circle, metres; so large that a drive of a few centimetres reaches the circle."""
TARGET_ID, FLOOR_ID, WALL_ID = 7, 1, 2
_INSTANCES = (
    Instance(id=FLOOR_ID, prim_path="/World/floor"),
    Instance(id=WALL_ID, prim_path="/World/wall"),
    Instance(id=TARGET_ID, prim_path="/World/chair_1", category="chair"),
)


def short_task() -> TaskConfig:
    """Returns a task that an episode of twelve steps can complete."""
    return TaskConfig(success_radius_m=RADIUS_M, hold_steps=2)


def job_for(index: int = 1, **changes: Any) -> Job:
    """Returns a job for which the smallest bundle is a valid result."""
    values: dict[str, Any] = {
        "run": "test-00000000",
        "plan_digest": "a" * 64,
        "root_seed": 42,
        "index": index,
        "draw": 0,
        "attempt": 1,
        "scene": "office",
        "scene_sha256": "b" * 64,
        "scene_bytes": 1000,
        "tier": Tier.NEAR,
        "split": Split.TRAIN_ID,
        "category": "chair",
        "target_id": "chair_001",
        "colour": "red",
        "template_id": "train_01",
        "instruction": instruction("train_01", "chair", "red"),
        "expert": ExpertName.PROPORTIONAL,
        "task": short_task(),
        "robot": RobotConfig(),
        "camera": CameraConfig(),
        "spawn": SpawnConfig(),
        "gains": ExpertConfig(),
    }
    return Job(**values | changes)


def empty_arrays(specs: Mapping[str, ArraySpec]) -> Arrays:
    """Returns an array of zeros for each spec; a dimension without a fixed size has length 12, the number of steps."""
    shapes = {name: [12 if side is None else side for side in spec.shape] for name, spec in specs.items()}
    return {name: np.zeros(shapes[name], spec.dtype) for name, spec in specs.items()}


@dataclass
class BundleParts:
    """Content of a bundle; the `with_` methods return changed copies, and `write` returns the bundle."""

    meta: EpisodeMeta
    arrays: EpisodeArrays
    frames: list[Frame]
    measure: Callable[[Mapping[str, ArraySpec]], Arrays] = empty_arrays
    """(specs of the arrays of one measurement) -> arrays; called for each measurement of the job's rig."""

    def with_meta(self, **changes: Any) -> BundleParts:
        return dataclasses.replace(self, meta=self.meta.model_copy(update=changes))

    def with_rollout(self, **changes: Any) -> BundleParts:
        return self.with_meta(rollout=self.meta.rollout.model_copy(update=changes))

    def with_job(self, **changes: Any) -> BundleParts:
        return self.with_meta(job=self.meta.job.model_copy(update=changes))

    def with_arrays(self, **changes: NDArray[Any]) -> BundleParts:
        return dataclasses.replace(self, arrays=dataclasses.replace(self.arrays, **changes))

    def with_frame(self, t: int, frame: Frame) -> BundleParts:
        return dataclasses.replace(self, frames=[*self.frames[:t], frame, *self.frames[t + 1 :]])

    def measured(self) -> BundleParts:
        """Returns the parts with rollout statistics computed from the poses."""
        track = measure_track(self.arrays.poses, self.meta.target_centroid_m, self.meta.target_footprint_m)
        return self.with_rollout(**track._asdict(), num_steps=len(self.arrays.poses))

    def write(self) -> bytes:
        """Returns the bundle."""
        return self.write_sealed()[0]

    def sealed(self) -> EpisodeMeta:
        """Returns the metadata as stored in the bundle, digests included."""
        return self.write_sealed()[1]

    def write_sealed(self) -> tuple[bytes, EpisodeMeta]:
        """Returns the bundle and the metadata that it contains."""
        file = io.BytesIO()
        writer = BundleWriter(file)
        if self.meta.job.record is Recording.STATES:
            for t in self.meta.job.sampled_steps(len(self.frames)):
                writer.add_digest(*self.frames[t])
        else:
            for frame in self.frames:
                writer.add_frame(*frame)
        for sensor in self.meta.job.view.rig.sensors if self.meta.job.view.rig else ():
            for t, specs in measurements_of(sensor, len(self.frames), self.meta.job.task.control_hz):
                writer.add_measurement(sensor, t, self.measure(specs))
        sealed = writer.finish(self.arrays, self.meta)
        return file.getvalue(), sealed


def parts_for(job: Job | None = None, steps: int = 12) -> BundleParts:
    """Returns the parts of the smallest valid bundle for a job: the robot accelerates, brakes and stops."""
    job = job or job_for()
    arrays = _drive(steps, job)
    frames = [_frame(float(x), steps_seen) for steps_seen, x in enumerate(arrays.poses[:, 0])]
    return BundleParts(_meta(job, arrays), arrays, frames)


def former_parts() -> BundleParts:
    """Returns the parts of the smallest bundle of format 1, whose poses are float32."""
    parts = parts_for()
    poses = parts.arrays.poses.astype(np.float32)
    measured = parts.with_arrays(poses=poses.astype(np.float64)).measured()
    return measured.with_arrays(poses=poses).with_meta(format=1)


def bundle_bytes(index: int = 1) -> bytes:
    """Returns the smallest valid bundle of an episode; cached, because many tests need it."""
    return _cached_bundle(index)


@functools.cache
def _cached_bundle(index: int) -> bytes:
    return parts_for(job_for(index)).write()


def _drive(steps: int, job: Job) -> EpisodeArrays:
    """Integrates the commands exactly along x from the origin."""
    hz, robot = job.task.control_hz, job.robot
    speeds: list[float] = []
    speed = 0.0
    for t in range(steps):
        wanted = robot.max_speed_mps if t < steps - 5 else 0.0
        speed = min(wanted, speed + robot.max_acceleration_mps2 / hz)
        speed = max(speed, speeds[-1] - robot.max_braking_mps2 / hz if speeds else 0.0)
        speeds.append(speed)
    actions = np.zeros((steps, 2), np.float32)
    actions[:, 0] = speeds
    poses = np.zeros((steps, 7))
    poses[1:, 0] = np.cumsum(actions[:-1, 0].astype(np.float64) / hz)
    poses[:, 3] = 1.0
    return EpisodeArrays(actions, tokens_of(actions), poses)


@functools.lru_cache(maxsize=24)
def _frame(x_m: float, step: int) -> Frame:
    """Returns a frame of wall, floor and target; the depth decreases from 3 m as the robot drives.

    The images are read-only, because episodes share them.
    """
    side = FRAME_SIZE_PX
    rgb = np.full((side, side, 3), 90, np.uint8)
    rgb[:, :, 1] = (np.arange(side)[:, None] + step) % 256
    depth = np.full((side, side), 3.0 - x_m, np.float32)
    ids = np.full((side, side), WALL_ID, np.uint16)
    ids[side // 2 :] = FLOOR_ID
    ids[280:360, 290:350] = TARGET_ID
    ids[:20], depth[:20] = 0, 0.0
    for image in (rgb, depth, ids):
        image.flags.writeable = False
    return rgb, depth, ids


def _meta(job: Job, arrays: EpisodeArrays) -> EpisodeMeta:
    track = measure_track(arrays.poses, GOAL_M)
    steps = len(arrays.poses)
    return EpisodeMeta(
        format=format_of(job),
        episode_id=job.episode_id,
        job=job,
        target_prim_path="/World/chair_1",
        target_instance_id=TARGET_ID,
        target_centroid_m=GOAL_M,
        phrase_is_unique=True,
        rollout=Rollout(
            end_reason=EndReason.SUCCESS,
            num_steps=steps,
            spawn_draws=1,
            collision_count=0,
            steps_visible=steps,
            **track._asdict(),
        ),
        instances=_INSTANCES if job.record is Recording.FRAMES else (),
        frame_digests=(),
        content_digest="0" * 32,
        provenance=Provenance(
            created_at=datetime(2026, 1, 2, 3, 4, 5, tzinfo=UTC),
            worker="host-1",
            fingerprint=Fingerprint(software={"minivla-factory": "0.1.0"}, renderer="synthetic", cpu="test"),
        ),
    )
