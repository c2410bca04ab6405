"""Computes what the robot sees of a scene graph from its start pose, on the grid. Renders nothing.

An object is surely visible if it is in the image and most lines of sight to it are free. A part of it is surely visible
if two of five lines are free. It is surely not visible if it is outside of the image, or a wall blocks every line of
sight. Other obstacles make it borderline.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from schemas.config import CameraConfig
from schemas.language.graph.scene_graph import SceneGraph
from schemas.language.thresholds import EDGE_RAD, SHOWN, VISIBLE_M
from schemas.support.numpy_types import Bools, Floats

_FAR_M = 15.0
"""Distance beyond which lines of sight are not traced, metres; objects in the image are borderline there."""
_FREE_SHARE = 0.5
_BEFORE_M = 0.12
"""Distance before the object at which a line of sight ends, metres, so the object itself does not block it."""
_STEP_CELLS = 1.5
_TALL_M = 0.6
"""An object is surely visible only if the part of it within the vertical range of the image has this height, metres, or
half of the object's height if that is less."""
_CHUNK = 512
"""Number of objects to which lines of sight are traced at once, which limits the memory."""
_POINTS = np.array([(0.0, 0.0), (-0.9, -0.9), (0.9, -0.9), (0.9, 0.9), (-0.9, 0.9)])
"""Ends of the lines of sight to an object: offsets from its centre, as shares of its half width and half length."""


@dataclass(frozen=True)
class SceneView:
    """Start pose and the objects of a scene graph as seen from there."""

    x: float
    """x of the camera in the world frame, metres."""
    y: float
    """y of the camera in the world frame, metres."""
    yaw: float
    """Heading, radians."""
    room: int
    """Room of the start, or 0."""
    area: int
    """Part of the room of the start; 0 if unknown, or if the start is close to an opening."""
    sure: Bools
    """(N,) objects that are surely visible."""
    shown: Bools
    """(N,) objects of which a part is surely visible; includes those that are surely visible."""
    possible: Bools
    """(N,) objects that may be visible."""
    bearing: Floats
    """(N,) angle from the heading to the middle of each object as it appears, not to its centre, radians in (-pi, pi],
    positive to the left."""
    distance: Floats
    """(N,) distance to the centre of each object, metres."""


def look(graph: SceneGraph, pose: tuple[float, float, float], camera: CameraConfig) -> SceneView:
    """Returns the view from a pose of base_link.

    Args:
        graph: scene graph.
        pose: x, y in metres and yaw in radians of base_link in the world frame.
        camera: camera of the robot.
    """
    x, y, yaw = pose
    eye = np.array(
        (
            x + math.cos(yaw) * camera.x_m - math.sin(yaw) * camera.y_m,
            y + math.sin(yaw) * camera.x_m + math.cos(yaw) * camera.y_m,
        )
    )
    low, high = graph.low[:, :2], graph.high[:, :2]
    centres = (low + high) / 2
    points = centres[:, None] + _POINTS * ((high - low) / 2)[:, None]
    offset = points - eye
    distance = np.hypot(offset[..., 0], offset[..., 1])
    bearing = np.remainder(np.arctan2(offset[..., 1], offset[..., 0]) - yaw + math.pi, 2 * math.pi) - math.pi
    half = math.radians(camera.fov_deg) / 2
    inside, maybe = np.abs(bearing) <= half - EDGE_RAD, np.abs(bearing) <= half + EDGE_RAD
    maybe[:, 0] |= (bearing.min(axis=1) < 0) & (bearing.max(axis=1) > 0) & (np.ptp(bearing, axis=1) < math.pi)
    inside &= _are_at_image_height(graph, distance[:, 0] * math.tan(half - EDGE_RAD), camera)[:, None]
    far = distance[:, 0] > _FAR_M
    sure, shown, possible = np.zeros(len(points), bool), np.zeros(len(points), bool), far & maybe.any(axis=1)
    near = np.flatnonzero(maybe.any(axis=1) & ~far)
    if len(near):
        blocked = _blocked(graph, eye, ways=offset[near], low=low[near] - _BEFORE_M, high=high[near] + _BEFORE_M)
        clear = (blocked == 0) & inside[near]
        share = np.where(distance[near, 0] <= VISIBLE_M, clear.mean(axis=1), 0.0)
        shown[near] = share >= SHOWN
        sure[near] = (share >= _FREE_SHARE) & inside[near, 0]
        possible[near] = ((blocked < 2) & maybe[near]).any(axis=1)
    room, area = graph.room_at(x, y), graph.area_at(x, y)
    # lines of sight end before the object, so the wall on which it hangs blocks none of them, even from the other side
    # of the wall; therefore, a hanging object is surely visible from its own room only
    is_facing = ~graph.hangs | (graph.room_of == room) & (room > 0)
    low_rad, high_rad = bearing.min(axis=1), bearing.max(axis=1)
    middle_rad = np.where(high_rad - low_rad < math.pi, (low_rad + high_rad) / 2, bearing[:, 0])
    return SceneView(
        *(float(eye[0]), float(eye[1]), yaw, room, area),
        *(sure & is_facing, shown & is_facing, possible, middle_rad, distance[:, 0]),
    )


def have_sight(graph: SceneGraph, eyes: Floats, numbers: NDArray[np.intp]) -> Bools:
    """Returns whether a part of each object would surely be visible from a point if the camera faced it.

    Args:
        graph: scene graph.
        eyes: (K, 2) x, y of the camera, metres.
        numbers: (K,) numbers of the objects.
    """
    return np.asarray(free_lines(graph, eyes, numbers).mean(axis=1) >= SHOWN)


def free_lines(graph: SceneGraph, eyes: Floats, numbers: NDArray[np.intp]) -> Bools:
    """Returns whether each of the lines of sight (K, 5) from points to objects meets no obstacle; see `have_sight`."""
    parts = [np.zeros((0, len(_POINTS)), bool)]
    for first in range(0, len(eyes), _CHUNK):
        eye, chosen = eyes[first : first + _CHUNK], numbers[first : first + _CHUNK]
        low, high = graph.low[chosen, :2], graph.high[chosen, :2]
        ways = line_ends(graph, chosen) - eye[:, None]
        blocked = _blocked(graph, eye, ways=ways, low=low - _BEFORE_M, high=high + _BEFORE_M)
        parts.append(blocked == 0)
    return np.concatenate(parts)


def line_ends(graph: SceneGraph, numbers: NDArray[np.intp]) -> Floats:
    """Returns the ends (K, 5, 2) of the lines of sight to some objects, metres; the first is the centre."""
    low, high = graph.low[numbers, :2], graph.high[numbers, :2]
    return np.asarray(((low + high) / 2)[:, None] + _POINTS * ((high - low) / 2)[:, None])


def _are_at_image_height(graph: SceneGraph, reach_m: Floats, camera: CameraConfig) -> Bools:
    """Returns whether at least `_TALL_M` or half the height of each object is within the vertical range of the image.

    Args:
        graph: scene graph.
        reach_m: (N,) vertical range of the image above and below the camera at the distance of each object, metres.
        camera: camera of the robot.
    """
    eye_m = graph.floor_m + camera.z_m
    low, high = graph.low[:, 2] - eye_m, graph.high[:, 2] - eye_m
    shown = np.minimum(high, reach_m) - np.maximum(low, -reach_m)
    return np.asarray(shown >= np.minimum((high - low) / 2, _TALL_M))


def _blocked(graph: SceneGraph, eye: Floats, ways: Floats, low: Floats, high: Floats) -> NDArray[np.uint8]:
    """Returns the highest values (K, 5) of the grid on lines of sight before they enter the bounding rectangles.

    Args:
        graph: scene graph.
        eye: (2,) or (K, 2) start of the lines, metres.
        ways: (K, 5, 2) vectors from the eye to the ends of the lines, metres.
        low: (K, 2) lower corners of the rectangles.
        high: (K, 2) upper corners of the rectangles.
    """
    grid = graph.sight_grid
    with np.errstate(divide="ignore", invalid="ignore"):
        sides = (np.stack((low, high)) - eye)[:, :, None] / ways  # share of each line at which it crosses each side
    entered = np.nan_to_num(np.minimum(*sides), nan=0.0).max(axis=-1).clip(0.0, 1.0)
    start = np.broadcast_to((eye - np.asarray(grid.origin_m)) / grid.resolution_m, (len(ways), 2))
    steps = (ways * (entered / grid.resolution_m)[..., None]).astype(np.float32)
    count = max(2, math.ceil(float(np.abs(steps).max()) / _STEP_CELLS))
    share = ((np.arange(count) + 0.5) / count).astype(np.float32)
    rows, columns = grid.values.shape
    row = start[:, 1, None, None].astype(np.float32) + steps[..., 1, None] * share
    column = start[:, 0, None, None].astype(np.float32) + steps[..., 0, None] * share
    if not _are_inside(start, steps, rows, columns):
        row, column = row.clip(0, rows - 1), column.clip(0, columns - 1)
    cells = row.astype(np.int32)
    cells *= columns
    cells += column.astype(np.int32)
    return np.asarray(grid.values.ravel()[cells].max(axis=-1), np.uint8)


def _are_inside(start: Floats, steps: NDArray[np.float32], rows: int, columns: int) -> bool:
    """Returns whether both ends of all lines, in cells, are within the grid."""
    flat = steps.reshape(-1, 2)
    first, last = start.min(axis=0), start.max(axis=0)
    low, high = first + flat.min(axis=0), last + flat.max(axis=0)
    return bool((np.minimum(low, first) >= 0).all() and (np.maximum(high, last) < (columns - 1, rows - 1)).all())
