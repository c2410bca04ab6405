"""Measures a driven path against a scene graph for the verifier of routes: angles, sides, lines of sight, widths.

Independent of the code that finds steps; works on polygons and single rays.
"""

from __future__ import annotations

import cmath
import itertools
import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from schemas.config import CameraConfig
from schemas.language.graph.scene_graph import SceneGraph
from schemas.support.geometry import footprint_distances

_EVERY = 4
_RAY_M = 0.03
_WALL = 2
_BEFORE_M = 0.25
_OWN_M = 0.2
"""Distance before a footprint within which an obstacle is taken for the object itself, metres."""
_PASSAGE_M, _DIRECTIONS, _MOST_M = 0.7, 8, 3.0


class PoseReplay:
    """Recorded poses on the map of a scene.

    Args:
        graph: scene graph.
        poses: (T, 7) poses of base_link in the world frame: x, y, z in metres and the quaternion w, x, y, z.
        camera: camera of the robot.
    """

    def __init__(self, graph: SceneGraph, poses: NDArray[np.float64], camera: CameraConfig) -> None:
        self.graph, self._camera = graph, camera
        self._points = [complex(x, y) for x, y in poses[:, :2].tolist()]
        # the forward axis of the body frame in the world frame
        self._ways = [complex(1 - 2 * (y * y + z * z), 2 * (x * y + w * z)) for w, x, y, z in poses[:, 3:].tolist()]
        self._increments = [cmath.phase(two / one) for one, two in zip(self._ways[:-1], self._ways[1:], strict=True)]

        moved = [abs(two - one) for one, two in zip(self._points[:-1], self._points[1:], strict=True)]
        self._driven = [0.0, *itertools.accumulate(moved)]
        self._rooms: list[int] = graph.room_grid.at(poses[:, :2]).tolist()

    def __len__(self) -> int:
        return len(self._points)

    def headings(self, start: int, end: int) -> list[float]:
        """Returns the headings of frames relative to the first one, radians, continuous."""
        total, headings = 0.0, [0.0]
        for increment in self._increments[start : end - 1]:
            total += increment
            headings.append(total)
        return headings

    def driven(self, start: int, end: int) -> float:
        """Returns the driven distance, metres."""
        return self._driven[max(end - 1, start)] - self._driven[start]

    def relative(self, number: int, t: int) -> complex:
        """Returns the middle of an object relative to the robot, metres: real part ahead, imaginary part left."""
        outline = self.graph.objects[number]
        low, high = outline.low_m, outline.high_m
        middle = complex((low[0] + high[0]) / 2, (low[1] + high[1]) / 2)
        way = self._ways[t] / abs(self._ways[t])
        return (middle - self._points[t]) / way

    def gap(self, number: int, t: int) -> float:
        """Returns the gap between the robot's centre and the footprint of an object, metres."""
        point = self._points[t]
        return float(footprint_distances((point.real, point.imag), self.graph.objects[number].outline_m))

    def frames(self, start: int, end: int) -> list[int]:
        """Returns every fourth frame of a span, and its last frame."""
        return [*range(start, end - 1, _EVERY), end - 1]

    def room(self, t: int) -> int:
        """Returns the room at a frame, or 0."""
        return self._rooms[t]

    def passage_width(self, t: int) -> float:
        """Returns the smallest width of the free space in any direction, metres. It is measured at points of the path
        within 0.7 m of its position at frame t."""
        near = [point for point in self._points if abs(point - self._points[t]) < _PASSAGE_M]
        points = np.array(near[:: max(1, len(near) // 12)])[:, None, None]
        ways = np.exp(1j * np.pi * np.arange(2 * _DIRECTIONS) / _DIRECTIONS)[:, None]
        rays = points + ways * np.arange(0.0, _MOST_M, _RAY_M)  # (points, directions, steps)
        hit = np.asarray(self.graph.sight_grid.at(np.stack((rays.real, rays.imag), axis=-1))) >= 1
        free = np.where(hit.any(axis=-1), hit.argmax(axis=-1) * _RAY_M, _MOST_M)
        return float((free[:, :_DIRECTIONS] + free[:, _DIRECTIONS:]).min())

    def _free(self, point: complex, way: complex, most_m: float, blocked: int = _WALL) -> float:
        """Returns the distance from a point along `way` to the first cell whose value is at least `blocked`; at most
        `most_m`."""
        steps = np.arange(0.0, most_m, _RAY_M)
        places = np.column_stack((point.real + way.real * steps, point.imag + way.imag * steps))
        hit = np.flatnonzero(self.graph.sight_grid.at(places).astype(np.int64) >= blocked)
        return float(steps[hit[0]]) if len(hit) else most_m

    def may_see(self, number: int, t: int, most_m: float) -> bool:
        """Returns whether an object within a distance may be in the image at a frame; only walls hide it."""
        if self.gap(number, t) > most_m:
            return False
        way = self._ways[t] / abs(self._ways[t])
        eye = self._points[t] + way * complex(self._camera.x_m, self._camera.y_m)
        half = math.radians(self._camera.fov_deg) / 2
        each = self.graph.objects[number]
        corners = [complex(x, y) for x, y in each.outline_m]
        for corner in (sum(corners) / len(corners), *corners):
            line = corner - eye
            if abs(line) < 0.2:
                return True
            if (
                abs(cmath.phase(line / way)) <= half
                and self._free(eye, line / abs(line), abs(line)) >= abs(line) - 0.25
            ):
                return True
        return False

    def shown_share(self, number: int, t: int) -> float:
        """Returns the share of points of a footprint that are in the image and have no obstacle before them."""
        way = self._ways[t] / abs(self._ways[t])
        eye = self._points[t] + way * complex(self._camera.x_m, self._camera.y_m)
        half = math.radians(self._camera.fov_deg) / 2
        corners = [complex(x, y) for x, y in self.graph.objects[number].outline_m]
        middle, shown = sum(corners) / len(corners), 0
        points = [middle, *(middle + 0.9 * (corner - middle) for corner in corners)]
        for line in (point - eye for point in points):
            entered = _entry(eye, line, corners)  # share of the line before it enters the object itself
            if abs(line) > 0 and abs(cmath.phase(line / way)) <= half:
                free = self._free(eye, line / abs(line), abs(line), blocked=1)
                shown += free >= min(abs(line), entered * abs(line)) - _OWN_M
        return shown / len(points)

    def position(self, t: int) -> tuple[float, float]:
        """Returns x, y of the robot, metres."""
        return self._points[t].real, self._points[t].imag

    def yaw(self, t: int) -> float:
        """Returns the heading of the robot, radians."""
        return cmath.phase(self._ways[t])

    def bearing(self, point: tuple[float, float], t: int) -> float:
        """Returns the angle from the heading to a point, radians, positive to the left."""
        return cmath.phase((complex(*point) - self._points[t]) / self._ways[t])


def _entry(eye: complex, line: complex, corners: Sequence[complex]) -> float:
    """Returns the share of a line after which it enters a convex polygon; 1 if it does not enter it."""
    low, high = 0.0, 1.0
    for a, b in zip(corners, [*corners[1:], corners[0]], strict=True):
        inward = (b - a) * 1j  # the corners are in counter-clockwise order
        towards = (line * inward.conjugate()).real
        before = ((a - eye) * inward.conjugate()).real
        if towards > 0:
            low = max(low, before / towards)
        elif towards < 0:
            high = min(high, before / towards)
        elif before > 0:
            return 1.0
    return low if low <= high else 1.0
