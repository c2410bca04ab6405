"""Benchmarks the complete loop of a simulation process: physics, control, rendering, encoding, bundle.

Every repetition runs the same jobs; the bundles are discarded. For comparison, a plain PyBullet pipeline as in the
PyBullet quick-start guide renders the same scene and poses: a static body per part, `getCameraImage` with TinyRenderer,
PNG by Pillow, and `np.save`.
"""

from __future__ import annotations

import io
import shutil
import tempfile
import time
from collections.abc import Callable, Iterable, Sequence
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from coordinator.archive.opening import open_archive
from coordinator.expansion.catalog import SceneEntry
from coordinator.validation.validate import validate
from factory.bench.machine import StageRecorder, StageTimes, measure_memory, reset_peak, resident_mib, stage_costs
from factory.bench.results import Memory, PlainPace, SceneRollout, Spread, StageCost
from schemas.bundle import BundleReader
from schemas.encoding.image_sizes import FRAME_SIZE_PX
from schemas.errors import InvalidBundle, WorldError
from schemas.job import Job
from schemas.scene import CompiledScene
from workers.geometry.camera import optical_pose, projection_matrix, view_matrix
from workers.geometry.pose import Pose
from workers.physics.mesh_lists import mesh_lists
from workers.physics.world import ColliderMesh, World
from workers.render.tiny import TinyScene
from workers.sim.attempt import Success, run_attempt
from workers.sim.context import SimulationContext


def run_baseline(scene: CompiledScene, job: Job, poses: Sequence[Pose], frames: int) -> PlainPace:
    """Generates frames, each after one physics step, and returns the rates.

    Args:
        scene: Scene.
        job: Job with the robot and the camera.
        poses: Poses of one or more episodes, in order. The frames use `frames` of them, evenly spread.
        frames: Number of timed frames, which follow one warm-up frame.
    """
    chosen = [poses[round(k)] for k in np.linspace(0, len(poses) - 1, frames)]
    recorder = StageRecorder()
    collider = _one_body_a_part(scene)
    with World(scene, collider, job.robot, job.task.control_hz) as world, closing(TinyScene(scene)) as shown:
        _make_frame(world, shown, job=job, pose=chosen[0], recorder=recorder)
        recorder.start()
        wall, cpu = time.perf_counter(), time.process_time()
        for pose in chosen:
            _make_frame(world, shown, job=job, pose=pose, recorder=recorder)
        wall, cpu = time.perf_counter() - wall, time.process_time() - cpu
    stages = {stage: 1000 * seconds / frames for stage, (seconds, _) in recorder.take().items()}
    return PlainPace(frames=frames, frames_per_s=frames / wall, frames_per_cpu_s=frames / cpu, stages=stages)


def _one_body_a_part(scene: CompiledScene) -> ColliderMesh:
    return ColliderMesh(
        tuple(
            piece
            for first, count in zip(scene.part_first.tolist(), scene.part_count.tolist(), strict=True)
            for piece in mesh_lists(
                scene.positions[first : first + count], np.arange(count, dtype=np.int32).reshape(-1, 3)
            )
        )
    )


def _make_frame(world: World, shown: TinyScene, job: Job, pose: Pose, recorder: StageRecorder) -> None:
    world.place(pose.x, pose.y, pose.yaw)
    world.step()
    recorder("physics")
    view, projection = view_matrix(optical_pose(pose, job.camera)), projection_matrix(job.camera)
    rgba, depth, bodies = shown.client.camera_image(FRAME_SIZE_PX, FRAME_SIZE_PX, view, projection, is_lit=True)
    recorder("getCameraImage")
    _save_png(rgba[:, :, :3])
    recorder("Pillow RGB")
    _save_png(bodies.astype(np.uint16))
    recorder("Pillow ids")
    np.save(io.BytesIO(), depth)
    recorder("np.save depth")


def _save_png(image: NDArray[np.uint8] | NDArray[np.uint16]) -> None:
    Image.fromarray(image).save(io.BytesIO(), "PNG")


StepCallback = Callable[[], None]
"""Called after every attempt."""


@dataclass(frozen=True)
class _Run:
    """Timed attempt."""

    frames: int
    """Number of frames; 0 for a failed attempt."""
    wall_s: float
    cpu_s: float
    stages: StageTimes
    poses: NDArray[np.float64]
    """(frames, 7) poses of the episode: x, y, z, qw, qx, qy, qz."""


def bench_rollout(
    jobs: Sequence[Job],
    entry: SceneEntry,
    context: SimulationContext,
    recorder: StageRecorder,
    repeats: int,
    plain_frames: int,
    tell: StepCallback,
) -> SceneRollout:
    """Runs every job `repeats` times, after one warm-up run, and returns the measurements.

    Args:
        jobs: Jobs of one scene.
        entry: Scene of the jobs.
        context: Simulation context opened with `recorder` as its stage timer.
        recorder: Recorder of the stage times.
        repeats: Number of timed repetitions of all jobs.
        plain_frames: Number of frames of the plain PyBullet pipeline, at poses spread over all episodes; 0 skips it.
        tell: Progress callback, called after every attempt, including the warm-up.

    Raises:
        WorldError: No job succeeded.
    """
    reset_peak()
    context.load(entry.path, entry.sha256)
    with tempfile.TemporaryFile() as file:
        sizes = _warm_up(jobs, context, file)
        delivery = time_delivery(file, repeats)
        tell()
        start_mib = resident_mib()
        rounds = [[_timed(job, context, recorder, file, tell) for job in jobs] for _ in range(repeats)]
        memory = measure_memory(start_mib)
    return _summarise(rounds, delivery, sizes, memory, jobs, entry, context, plain_frames)


def _warm_up(jobs: Sequence[Job], context: SimulationContext, file: BinaryIO) -> dict[str, float]:
    """Runs jobs until one succeeds; returns the size of its bundle by kind of member, kB per frame."""
    details = []
    for job in jobs:
        _rewind(file)
        outcome = run_attempt(job, context, out=file, sid="bench", on_step=_ignore)
        if isinstance(outcome, Success):
            bundle = BundleReader(file)
            return {kind: size / bundle.length / 1000 for kind, size in bundle.member_bytes().items()}
        details.append(outcome.detail)
    raise WorldError(f"none of {len(jobs)} jobs in {jobs[0].scene} succeeded, so nothing can be measured: {details[0]}")


def _timed(job: Job, context: SimulationContext, recorder: StageRecorder, file: BinaryIO, tell: StepCallback) -> _Run:
    _rewind(file)
    wall, cpu = time.perf_counter(), time.process_time()
    recorder.start()
    outcome = run_attempt(job, context, out=file, sid="bench", on_step=_ignore)
    wall, cpu = time.perf_counter() - wall, time.process_time() - cpu
    tell()
    stages = recorder.take()
    if isinstance(outcome, Success):
        return _Run(outcome.meta.rollout.num_steps, wall, cpu, stages, BundleReader(file).arrays.poses)
    return _Run(0, wall, cpu, stages, np.empty((0, 7)))


def _rewind(file: BinaryIO) -> None:
    file.seek(0)
    file.truncate()


def _ignore(step: int) -> None:
    pass


def _summarise(
    rounds: list[list[_Run]],
    delivery: tuple[StageCost, ...],
    sizes: dict[str, float],
    memory: Memory,
    jobs: Sequence[Job],
    entry: SceneEntry,
    context: SimulationContext,
    plain_frames: int,
) -> SceneRollout:
    won = [[run for run in runs if run.frames] for runs in rounds]
    frames = sum(run.frames for run in won[0])
    wall = Spread.of([frames / sum(run.wall_s for run in runs) for runs in won])
    cpu = Spread.of([frames / sum(run.cpu_s for run in runs) for runs in won])
    spent = sum(run.wall_s for runs in rounds for run in runs)
    rows = np.concatenate([run.poses for run in won[0]]).astype(np.float64)
    poses = [Pose(*row) for row in rows.tolist()]
    plain = run_baseline(context.loaded(entry.sha256).compiled, jobs[0], poses, plain_frames) if plain_frames else None
    return SceneRollout(
        frames_per_s_per_core=wall.median,
        frames_per_cpu_s=cpu.median,
        wall=wall,
        cpu=cpu,
        by_job=Spread.of([run.frames / run.wall_s for run in won[0]]),
        stages=stage_costs([(frames, _add(run.stages for run in runs)) for runs in won]),
        delivery=delivery,
        episodes=len(won[0]),
        frames=frames,
        failed_attempts=len(rounds[0]) - len(won[0]),
        failed_share_of_time=sum(run.wall_s for runs in rounds for run in runs if not run.frames) / spent,
        kb_per_frame=sizes,
        memory=memory,
        plain=plain,
        ratio=None if plain is None else wall.median / plain.frames_per_s,
    )


def _add(runs: Iterable[StageTimes]) -> StageTimes:
    total: StageTimes = {}
    for run in runs:
        for stage, (wall, cpu) in run.items():
            before = total.get(stage, (0.0, 0.0))
            total[stage] = (before[0] + wall, before[1] + cpu)
    return total


def time_delivery(file: BinaryIO, repeats: int) -> tuple[StageCost, ...]:
    """Validates and archives the bundle in `file` `repeats` times and returns the cost of both stages per frame.

    Raises:
        InvalidBundle: The bundle is not valid, so its validation time would not be representative.
    """
    return stage_costs([_deliver(file) for _ in range(repeats)])


def _deliver(file: BinaryIO) -> tuple[int, StageTimes]:
    recorder = StageRecorder()
    with tempfile.TemporaryDirectory(prefix="bench-") as folder, open_archive(Path(folder)) as archive:
        recorder.start()
        bundle = BundleReader(file)
        findings = validate(bundle)
        recorder("validate")
        index = bundle.meta.job.index
        file.seek(0)
        with archive.stage(index) as staged:
            shutil.copyfileobj(file, staged, 1 << 20)
            archive.publish(staged, index)
        recorder("archive")
    if findings:
        raise InvalidBundle("the bundle of the benchmark is invalid", findings)
    return bundle.length, recorder.take()
