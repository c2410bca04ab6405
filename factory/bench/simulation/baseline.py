"""Plain PyBullet pipeline for comparison, as in the PyBullet quick-start guide, on the same scene and poses.

Uses one static body per part with its mesh, `getCameraImage` with the defaults of TinyRenderer, PNG by Pillow, and
`np.save`. Uses neither the renderers nor the encoders of this product.
"""

from __future__ import annotations

import io
import time
from collections.abc import Sequence
from contextlib import closing

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from factory.bench.machine import StageRecorder
from factory.bench.model import PlainPace
from schemas.encoding.image_sizes import FRAME_SIZE_PX
from schemas.job import Job
from schemas.scene import CompiledScene
from workers.geometry.camera import optical_pose, projection_matrix, view_matrix
from workers.geometry.pose import Pose
from workers.physics.mesh_lists import mesh_lists
from workers.physics.world import ColliderMesh, World
from workers.render.tiny import TinyScene


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
        _make_frame(world, shown, job, chosen[0], recorder)
        recorder.start()
        wall, cpu = time.perf_counter(), time.process_time()
        for pose in chosen:
            _make_frame(world, shown, job, pose, recorder)
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
    image = shown.client.camera_image(FRAME_SIZE_PX, FRAME_SIZE_PX, view, projection, is_lit=True)
    recorder("getCameraImage")
    _save_png(image.rgba[:, :, :3])
    recorder("Pillow RGB")
    _save_png(image.bodies.astype(np.uint16))
    recorder("Pillow ids")
    np.save(io.BytesIO(), image.depth)
    recorder("np.save depth")


def _save_png(image: NDArray[np.uint8] | NDArray[np.uint16]) -> None:
    Image.fromarray(image).save(io.BytesIO(), "PNG")
