"""Chooses viewpoints of a scene: renders many small candidate frames and keeps those with the highest score.

Deterministic. Does not write images.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from schemas.config import CameraConfig
from schemas.frame import Frame
from schemas.scene import CompiledScene
from workers.geometry.pose import Pose
from workers.render import Renderer

_HEADINGS = 10
_NEAR_M, _FULL_DEPTH_M = 0.7, 4.0
_SATURATED = 0.05
"""An object that covers more than this share of a frame does not increase the score further."""
_CLUTTER = 0.15
"""Weight of an object that is not a target, relative to a target."""
_SEEN_BEFORE = 0.3
_BARE_SHARE = 0.45


@dataclass(frozen=True)
class Height:
    """Camera height, pitch and field of view of a viewpoint."""

    eye_m: float
    pitch_rad: float
    fov_deg: float


EYE = Height(1.5, math.radians(-11.0), 80.0)
"""View of a standing person who looks slightly downwards."""


@dataclass(frozen=True)
class Viewpoint:
    """Pose of the robot base in the world frame, with its camera."""

    pose: Pose
    camera: CameraConfig


def looking(
    eye: NDArray[np.float64], yaw_rad: float, pitch_rad: float, fov_deg: float, near_m: float = 0.05
) -> Viewpoint:
    """Returns the viewpoint at a position (3,), metres, with heading `yaw_rad` and elevation `pitch_rad`."""
    cos_yaw, sin_yaw = math.cos(yaw_rad / 2), math.sin(yaw_rad / 2)
    cos_pitch, sin_pitch = math.cos(-pitch_rad / 2), math.sin(-pitch_rad / 2)
    pose = Pose(
        float(eye[0]),
        float(eye[1]),
        z=float(eye[2]),
        qw=cos_yaw * cos_pitch,
        qx=-sin_yaw * sin_pitch,
        qy=cos_yaw * sin_pitch,
        qz=sin_yaw * cos_pitch,
    )
    return Viewpoint(pose, CameraConfig(name="view", x_m=0.0, y_m=0.0, z_m=1e-6, fov_deg=fov_deg, near_m=near_m))


def try_views(scene: CompiledScene, height: Height | None, places: int = 48) -> Iterator[Viewpoint]:
    """Yields viewpoints at the spawn points in all directions; uses the robot's camera if `height` is `None`."""
    for number, (x, y) in enumerate(scene.spawns[:places].astype(float)):
        for heading in range(_HEADINGS):
            yaw = 2 * math.pi * (heading + number * 0.382) / _HEADINGS
            if height is None:
                yield Viewpoint(Pose.planar(x, y, yaw, scene.info.floor_height_m), CameraConfig())
            else:
                place = np.array((x, y, scene.info.floor_height_m + height.eye_m))
                yield looking(place, yaw, height.pitch_rad, height.fov_deg)


def score_view(frame: Frame, targets: frozenset[int], seen: Iterable[int] = ()) -> float:
    """Returns the score of a frame: high for large and distant objects that earlier images do not show.

    Args:
        frame: rendered frame.
        targets: instance ids of the targets.
        seen: instance ids that earlier images show.
    """
    counts = np.bincount(frame.ids.ravel())
    share = counts / frame.ids.size
    known = set(seen)
    total = 0.0
    for number in np.flatnonzero(counts[1:]) + 1:
        value = math.sqrt(min(float(share[number]), _SATURATED)) * (1.0 if int(number) in targets else _CLUTTER)
        total += value * (_SEEN_BEFORE if int(number) in known else 1.0)
    met = frame.depth[frame.depth > 0]
    if not len(met) or float(np.quantile(met, 0.05)) < _NEAR_M:
        return 0.25 * total
    bare = max(0.0, float(share[1:].max(initial=0.0)) - _BARE_SHARE)
    return total * (1 - bare) * min(1.0, 0.4 + float(np.median(met)) / _FULL_DEPTH_M)


def best_views(eye: Renderer, scene: CompiledScene, height: Height | None, count: int) -> list[Viewpoint]:
    """Chooses viewpoints one after the other, each with the highest score.

    Objects that earlier viewpoints show count less. A viewpoint close to an earlier one is chosen only if its heading
    differs.

    Args:
        eye: renderer of small frames.
        scene: compiled scene.
        height: camera of a person, or `None` for the robot's camera.
        count: number of viewpoints.
    """
    targets = frozenset(target.instance_id for target in scene.info.targets)
    tried: list[tuple[Viewpoint, Frame]] = []
    for view in try_views(scene, height):
        eye.load(scene, view.camera)
        tried.append((view, eye.render(view.pose)))
    chosen: list[Viewpoint] = []
    seen: set[int] = set()
    while tried and len(chosen) < count:
        values = [score_view(frame, targets, seen) for _, frame in tried]
        view, frame = tried[int(np.argmax(values))]
        chosen.append(view)
        counts = np.bincount(frame.ids.ravel())
        seen |= {int(number) for number in np.flatnonzero(counts > 0.002 * frame.ids.size)}
        tried = [(other, look) for other, look in tried if _is_apart(other.pose, view.pose)]
    return chosen


def _is_apart(one: Pose, other: Pose) -> bool:
    """Returns whether two viewpoints differ enough in position or heading."""
    turn = abs(math.remainder(one.yaw - other.yaw, 2 * math.pi))
    return math.hypot(one.x - other.x, one.y - other.y) > 2.0 or turn > math.radians(80)
