"""Rendering alone: the images of poses all over a scene. Runs no physics and encodes nothing."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence

import numpy as np

from factory.bench.model import SceneRender, Spread, StageCost
from factory.bench.stage_times import StageClock, StageTimes, stage_costs
from schemas.config import CameraConfig
from schemas.scene import CompiledScene
from workers.geometry.camera import optical_pose, projection_matrix, view_matrix
from workers.geometry.pose import Pose
from workers.render import Renderer
from workers.render.cull import PartBounds, visible_parts

__all__ = ["bench_render", "poses_in"]

_SEED = 20


def poses_in(scene: CompiledScene, count: int) -> list[Pose]:
    """Returns poses on the scene's surveyed floor points, headings all round; the same every time."""
    rng = np.random.default_rng(_SEED)
    points = scene.spawns[rng.integers(len(scene.spawns), size=count)].astype(np.float64)
    yaws = rng.uniform(-np.pi, np.pi, count)
    height = scene.info.floor_height_m
    return [Pose.planar(x, y, yaw, height) for (x, y), yaw in zip(points.tolist(), yaws.tolist(), strict=True)]


def bench_render(
    scene: CompiledScene,
    renderer: Renderer,
    watch: StageClock,
    camera: CameraConfig,
    frames: int,
    repeats: int,
) -> SceneRender:
    """Renders the same poses in every repeat, after one round that warms up, and returns the figures.

    Args:
        scene: the place.
        renderer: opened with `watch` as its lap.
        watch: keeps the time of the stages.
        camera: of the robot.
        frames: poses.
        repeats: rounds that are timed.
    """
    poses = poses_in(scene, frames)
    renderer.load(scene, camera)
    seconds, stages = _time(renderer.render, watch, poses, repeats)
    _, without = _time(renderer.render_depth_and_ids, watch, poses, repeats)
    return SceneRender(
        frames=frames,
        frames_per_s=Spread.of([frames / each for each in seconds]),
        stages=stages,
        without_colour=without,
        triangles=len(scene.positions) // 3,
        triangles_in_view=_triangles_in_view(scene, camera, poses),
    )


def _time(
    draw: Callable[[Pose], object], watch: StageClock, poses: Sequence[Pose], repeats: int
) -> tuple[list[float], tuple[StageCost, ...]]:
    """Returns the seconds of every round and the stages, after one round that warms up."""
    _round(draw, watch, poses)
    rounds = [_round(draw, watch, poses) for _ in range(repeats)]
    return [seconds for seconds, _ in rounds], stage_costs([(len(poses), times) for _, times in rounds])


def _round(draw: Callable[[Pose], object], watch: StageClock, poses: Sequence[Pose]) -> tuple[float, StageTimes]:
    start_s = time.perf_counter()
    watch.start()
    for pose in poses:
        draw(pose)
    return time.perf_counter() - start_s, watch.take()


def _triangles_in_view(scene: CompiledScene, camera: CameraConfig, poses: Sequence[Pose]) -> float:
    bounds, projection = PartBounds.of(scene), projection_matrix(camera)
    eyes = [optical_pose(pose, camera) for pose in poses]
    seen = [visible_parts(bounds, projection @ view_matrix(eye), eye.eye) for eye in eyes]
    return sum(float(scene.part_count[parts].sum()) / 3 for parts in seen) / len(poses)
