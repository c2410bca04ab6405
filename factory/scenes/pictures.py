"""Pictures of a compiled scene for people: the map, and views from the robot's eye at surveyed points."""

from __future__ import annotations

import math
import os
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from PIL import Image

from factory.scenes.topdown import encode_topdown
from schemas.config import CameraConfig
from schemas.scene import CompiledScene
from schemas.terms import RendererKind
from workers.pose import Pose
from workers.render.choose import open_renderer

__all__ = ["draw_scene"]


def draw_scene(scene: CompiledScene, folder: Path, views: int, renderer: RendererKind) -> Iterator[Path]:
    """Writes `map.png` and `view_00.png` and so on, and yields each path.

    Args:
        scene: the package.
        folder: made when missing.
        views: how many; spread over the spawn points, each facing its nearest target.
        renderer: which one draws.
    """
    os.environ.setdefault("LP_NUM_THREADS", "0")
    folder.mkdir(parents=True, exist_ok=True)
    chart = folder / "map.png"
    chart.write_bytes(encode_topdown(scene))
    yield chart
    with open_renderer(renderer) as eye:
        eye.load(scene, CameraConfig())
        for number, pose in enumerate(_viewpoints(scene, views)):
            path = folder / f"view_{number:02d}.png"
            Image.fromarray(eye.render(pose).rgb).save(path)
            yield path


def _viewpoints(scene: CompiledScene, count: int) -> Iterator[Pose]:
    centroids = np.array([target.centroid_m[:2] for target in scene.info.targets])
    for x, y in scene.spawns[:count].astype(float):
        offsets = centroids - (x, y)
        distances = np.linalg.norm(offsets, axis=1)
        dx, dy = offsets[int(np.where(distances > 1.5, distances, np.inf).argmin())]
        yield Pose.planar(float(x), float(y), math.atan2(dy, dx), scene.info.floor_height_m)
