"""Benchmarks rendering at poses spread over a scene. Runs no physics and encodes nothing."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence

import numpy as np

from factory.bench.machine import StageRecorder, StageTimes, stage_costs
from factory.bench.results import SceneRender, Spread, StageCost
from factory.dataset.rendering import shrink_frame
from schemas.config import CameraConfig
from schemas.encoding.image_sizes import FRAME_SIZE_PX
from schemas.frame import Frame
from schemas.scene import CompiledScene
from workers.geometry.camera import optical_pose, projection_matrix, view_matrix
from workers.geometry.pose import Pose
from workers.render import Renderer
from workers.render.visible_parts import PartBounds, visible_parts

_SEED = 20


def poses_in(scene: CompiledScene, count: int) -> list[Pose]:
    """Returns deterministic random poses on the surveyed floor points of a scene, with uniform headings."""
    rng = np.random.default_rng(_SEED)
    points = scene.spawns[rng.integers(len(scene.spawns), size=count)].astype(np.float64)
    yaws = rng.uniform(-np.pi, np.pi, count)
    height = scene.info.floor_height_m
    return [Pose.planar(x, y, yaw, height) for (x, y), yaw in zip(points.tolist(), yaws.tolist(), strict=True)]


def bench_render(
    scene: CompiledScene,
    renderer: Renderer,
    recorder: StageRecorder,
    camera: CameraConfig,
    frames: int,
    repeats: int,
    size: int = FRAME_SIZE_PX,
    antialias: int = 1,
) -> SceneRender:
    """Renders the same poses in every repetition, after one warm-up round, and returns the measurements.

    Args:
        scene: Scene.
        renderer: Renderer opened with `recorder` as its stage timer.
        recorder: Recorder of the stage times.
        camera: Camera of the robot.
        frames: Number of poses.
        repeats: Number of timed rounds.
        size: Width and height of the frames, pixels.
        antialias: Samples per pixel along each axis.
    """

    def draw(pose: Pose) -> Frame:
        frame = renderer.render(pose, size * antialias)
        if antialias > 1:
            frame = shrink_frame(frame, antialias)
            recorder("antialias")
        return frame

    poses = poses_in(scene, frames)
    renderer.load(scene, camera)
    seconds, stages = _time(draw, recorder, poses, repeats)
    without: tuple[StageCost, ...] = ()
    if (size, antialias) == (FRAME_SIZE_PX, 1):
        _, without = _time(renderer.render_depth_and_ids, recorder, poses, repeats)
    return SceneRender(
        frames=frames,
        frames_per_s=Spread.of([frames / each for each in seconds]),
        stages=stages,
        without_colour=without,
        triangles=len(scene.positions) // 3,
        triangles_in_view=_triangles_in_view(scene, camera, poses),
    )


def _time(
    draw: Callable[[Pose], object], recorder: StageRecorder, poses: Sequence[Pose], repeats: int
) -> tuple[list[float], tuple[StageCost, ...]]:
    """Returns the seconds of each round and the stage costs, after one warm-up round."""
    _round(draw, recorder, poses)
    rounds = [_round(draw, recorder, poses) for _ in range(repeats)]
    return [seconds for seconds, _ in rounds], stage_costs([(len(poses), times) for _, times in rounds])


def _round(draw: Callable[[Pose], object], recorder: StageRecorder, poses: Sequence[Pose]) -> tuple[float, StageTimes]:
    start_s = time.perf_counter()
    recorder.start()
    for pose in poses:
        draw(pose)
    return time.perf_counter() - start_s, recorder.take()


def _triangles_in_view(scene: CompiledScene, camera: CameraConfig, poses: Sequence[Pose]) -> float:
    bounds, projection = PartBounds.of(scene), projection_matrix(camera)
    eyes = [optical_pose(pose, camera) for pose in poses]
    seen = [visible_parts(bounds, projection @ view_matrix(eye), eye.eye) for eye in eyes]
    return sum(float(scene.part_count[parts].sum()) / 3 for parts in seen) / len(poses)
