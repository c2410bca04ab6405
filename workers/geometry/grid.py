"""Occupancy grid: free poses of the footprint, free straight lines, lines of sight, and the connected floor.

Pure geometry of arrays in the world frame, metres and radians. Does not render, plan paths or simulate.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any, Self

import numpy as np
import scipy  # loads a submodule at its first use; many commands use no submodule
from numpy.typing import ArrayLike, NDArray

from schemas.scene import CompiledScene, Target
from schemas.support import portable
from schemas.support.numpy_types import Bools, Floats

DISC_OFFSETS_M = (-0.46, -0.2335, -0.01)
"""Centres of the three discs that cover the footprint, x in base_link (docs/design/robot.md#footprint-on-the-grid)."""
DISC_RADIUS_M = 0.29
"""Radius of the discs that cover the footprint, metres."""
BODY_CENTRE_M = -0.2335
"""Centre of the footprint, x in base_link, metres."""
HALF_WIDTH_M = 0.25
"""Half the width of the footprint, metres."""
FRONT_M = 0.14
"""Foremost point of the footprint, x in base_link, metres."""
CONNECT_CLEARANCE_M = 0.36
"""Clearance that the body centre needs for the robot to pass, metres: half the robot's width plus a margin."""
FREE, OCCUPIED, HIDING = 0, 1, 2
"""Values of `CompiledScene.occupancy`; `HIDING` is occupied and blocks the line of sight."""


@dataclass(frozen=True, eq=False)
class Grid:
    """Occupancy of the robot's height band; rows are y and columns are x; space outside the grid is occupied."""

    occupancy: NDArray[np.uint8]
    """(H, W) 0 free, 1 occupied, 2 occupied and blocking the line of sight."""
    origin_m: tuple[float, float]
    """World x, y of the outer corner of cell (0, 0), metres."""
    resolution_m: float
    """Side of a cell, metres."""

    @classmethod
    def from_scene(cls, scene: CompiledScene) -> Self:
        return cls(scene.occupancy, scene.info.grid_origin_m, scene.info.grid_resolution_m)

    @cached_property
    def clearance(self) -> Floats:
        """(H, W) distance from each cell's centre to that of the nearest occupied cell, metres; 0 if occupied."""
        walled = np.pad(self.occupancy == FREE, 1)
        field: Floats = scipy.ndimage.distance_transform_edt(walled)[1:-1, 1:-1] * self.resolution_m
        return field

    @cached_property
    def results(self) -> dict[object, dict[Any, Any]]:
        """Results of functions of this grid by function and arguments; see `workers.planning.kept`."""
        return {}

    def cell_of(self, xy: ArrayLike) -> NDArray[np.int64]:
        """Returns (row, column) of the cells that contain the points (..., 2); they may be outside the grid."""
        column_row = np.floor((np.asarray(xy, float) - self.origin_m) / self.resolution_m).astype(np.int64)
        return column_row[..., ::-1]

    def centre_of(self, cells: ArrayLike) -> Floats:
        """Returns world x, y of the centres of cells (..., 2) given as (row, column), metres."""
        row_column = np.asarray(cells, float)
        return np.asarray(self.origin_m) + (row_column[..., ::-1] + 0.5) * self.resolution_m

    def values_at(self, field: NDArray[np.generic], xy: ArrayLike, outside: float) -> NDArray[np.generic]:
        """Returns the values of a field (H, W) at points (..., 2); `outside` is the value outside the grid."""
        at = np.asarray(xy, float)
        columns, rows = (np.floor((at[..., k] - self.origin_m[k]) / self.resolution_m).astype(np.int64) for k in (0, 1))
        height, width = field.shape
        inside = (rows >= 0) & (rows < height) & (columns >= 0) & (columns < width)
        if inside.all():
            return np.asarray(field[rows, columns])
        looked_up = field[np.where(inside, rows, 0), np.where(inside, columns, 0)]
        return np.where(inside, looked_up, field.dtype.type(outside))

    def clearance_at(self, xy: ArrayLike) -> Floats:
        """Returns the clearance at points (..., 2), metres; 0 outside the grid."""
        return self.values_at(self.clearance, xy, 0.0).astype(np.float64)

    def are_poses_free(self, x: ArrayLike, y: ArrayLike, yaw: ArrayLike, margin_m: float = 0.0) -> Bools:
        """Returns whether the footprint with `margin_m` around it is free at each of the base_link poses."""
        return self._least_clearance(x, y, yaw) >= DISC_RADIUS_M + margin_m

    def room_at_poses(self, x: ArrayLike, y: ArrayLike, yaw: ArrayLike) -> Floats:
        """Returns the free space around the footprint at base_link poses, metres; negative in an obstacle."""
        return self._least_clearance(x, y, yaw) - DISC_RADIUS_M

    def _least_clearance(self, x: ArrayLike, y: ArrayLike, yaw: ArrayLike) -> Floats:
        x, y, yaw = (np.asarray(values, float) for values in (x, y, yaw))
        # computed before the headings are broadcast, because many poses often share one heading
        cos, sin = portable.cos(yaw), portable.sin(yaw)
        discs = [self.clearance_at(stacked(x + along * cos, y + along * sin)) for along in DISC_OFFSETS_M]
        return np.asarray(np.minimum(np.minimum(discs[0], discs[1]), discs[2]))

    def is_pose_free(self, x: float, y: float, yaw: float, margin_m: float = 0.0) -> bool:
        """Returns whether the footprint of a base_link pose with `margin_m` around it is free."""
        return bool(self.are_poses_free(x, y, yaw, margin_m))

    def are_lines_free(self, starts: ArrayLike, ends: ArrayLike, clearance_m: float) -> Bools:
        """Returns whether the robot can move base_link along each of the segments from `starts` to `ends` (N, 2).

        The area that the body sweeps, up to its front at the end pose, must have `clearance_m` of free space on both
        sides. Three tracks of discs, sampled at half the grid's resolution, cover that area.
        """
        a, b = np.atleast_2d(np.asarray(starts, float)), np.atleast_2d(np.asarray(ends, float))
        a, b = np.broadcast_arrays(a, b)
        step = b - a
        length = np.linalg.norm(step, axis=1)
        side = np.stack([-step[:, 1], step[:, 0]], axis=1) / np.maximum(length, 1e-9)[:, None]
        half_width = HALF_WIDTH_M + clearance_m
        radius = max(FRONT_M, half_width / 3)
        free = np.ones(len(a), bool)
        for offset in (0.0, half_width - radius, radius - half_width):
            rest = np.flatnonzero(free)
            shift = offset * side[rest]
            free[rest] = self._are_tracks_free(a[rest] + shift, b[rest] + shift, radius)
        return free

    def is_line_free(self, start: ArrayLike, end: ArrayLike, clearance_m: float) -> bool:
        """Returns whether the robot can drive straight from `start` to `end` with `clearance_m` free on both sides."""
        return bool(self.are_lines_free(start, end, clearance_m)[0])

    def _are_tracks_free(self, a: Floats, b: Floats, radius: float) -> Bools:
        """Returns whether a disc of `radius` metres is free everywhere on each segment."""
        owner, points = self._samples(a, b)
        blocked = self.clearance_at(points) < radius
        free = np.ones(len(a), bool)
        free[owner[blocked]] = False
        return free

    def _samples(self, a: Floats, b: Floats) -> tuple[NDArray[np.int64], Floats]:
        """Returns points on the segments at half the resolution or closer, ends included, and the segment of each."""
        step = b - a
        counts = np.ceil(np.linalg.norm(step, axis=1) / (self.resolution_m / 2)).astype(np.int64) + 1
        owner = np.repeat(np.arange(len(a)), counts)
        rank = np.arange(len(owner)) - np.repeat(np.cumsum(counts) - counts, counts)
        share = rank / np.repeat(np.maximum(counts - 1, 1), counts)
        points = np.empty((len(owner), 2))
        for k in (0, 1):
            points[:, k] = np.repeat(a[:, k], counts) + np.repeat(step[:, k], counts) * share
        return owner, points

    def have_sight(self, xy: ArrayLike, target: Target) -> Bools:
        """Returns whether each of the points (N, 2) has a line of sight to a target.

        Only tall obstacles block it: walls and full racks that fill the robot's height band and are higher than its
        camera and a person, but not desks. The target's box and one cell around it never block it.
        """
        points = np.atleast_2d(np.asarray(xy, float))
        centre, reach = np.asarray(target.centroid_m[:2]), np.asarray(target.size_m[:2]) / 2
        return self.see_boxes(points, np.broadcast_to(centre, points.shape), np.broadcast_to(reach, points.shape))

    def see_boxes(self, points: Floats, centres: Floats, reaches: Floats) -> Bools:
        """Returns whether each of the points (N, 2) has a line of sight to its target; see `have_sight`.

        Args:
            points: x, y, metres.
            centres: (N, 2) centres of the targets' boxes, metres.
            reaches: (N, 2) half the extents of the boxes, metres.
        """
        owner, samples = self._samples(points, centres)
        hiding = np.flatnonzero(self.values_at(self.occupancy, samples, FREE) == HIDING)
        of_hiding = owner[hiding]
        is_own_box = (np.abs(samples[hiding] - centres[of_hiding]) <= reaches[of_hiding] + self.resolution_m).all(
            axis=1
        )
        seen = np.ones(len(points), bool)
        seen[of_hiding[~is_own_box]] = False
        return seen

    def has_sight(self, xy: ArrayLike, target: Target) -> bool:
        return bool(self.have_sight(xy, target)[0])

    def connected_floor(self, seed_xy: ArrayLike | None = None, clearance_m: float = CONNECT_CLEARANCE_M) -> Bools:
        """Returns the connected cells (H, W) on which the body centre has `clearance_m`.

        Args:
            seed_xy: world x, y of a point in the component, metres; `None`, or a point outside the floor, selects the
                largest component.
            clearance_m: required clearance of the body centre, metres.
        """
        parts, count = scipy.ndimage.label(self.clearance >= clearance_m, structure=np.ones((3, 3)))
        if count == 0:
            return np.zeros(self.occupancy.shape, bool)
        wanted = 0 if seed_xy is None else int(self.values_at(parts, seed_xy, 0))
        if wanted == 0:
            wanted = int(np.bincount(parts.ravel())[1:].argmax()) + 1
        floor: Bools = parts == wanted
        return floor


def separate_floors(grid: Grid, least_m2: float, most: int) -> list[Bools]:
    """Returns the connected floors (H, W) of a grid, the largest first; without any floor, one empty mask.

    Args:
        grid: occupancy grid.
        least_m2: minimum area of a floor, square metres; the largest may be smaller.
        most: maximum number of floors.
    """
    parts, count = scipy.ndimage.label(grid.clearance >= CONNECT_CLEARANCE_M, structure=np.ones((3, 3)))
    if count == 0:
        return [np.zeros(grid.occupancy.shape, bool)]
    sizes = np.bincount(parts.ravel())[1:]
    order = np.argsort(-sizes, kind="stable")[:most]
    rest = [row for row in order[1:] if sizes[row] * grid.resolution_m**2 >= least_m2]
    return [np.asarray(parts == row + 1) for row in (order[0], *rest)]


def are_within(points: Floats, boxes: Floats) -> Bools:
    """Returns whether each of the points (N, 2) is inside any of the rectangles (K, 2, 2), lower and upper corner."""
    inside = np.ones((len(boxes), len(points)), bool)
    for k in (0, 1):
        inside &= (points[:, k] > boxes[:, 0, k, None]) & (points[:, k] < boxes[:, 1, k, None])
    return np.asarray(inside.any(axis=0))


def body_centre(x: ArrayLike, y: ArrayLike, yaw: ArrayLike) -> Floats:
    """Returns the body centre (..., 2) of base_link poses, world frame, metres."""
    x, y, yaw = (np.asarray(values, float) for values in (x, y, yaw))
    return stacked(x + BODY_CENTRE_M * portable.cos(yaw), y + BODY_CENTRE_M * portable.sin(yaw))


def stacked(x: Floats, y: Floats) -> Floats:
    """Returns points (..., 2) from their coordinates, which broadcast."""
    return np.stack(np.broadcast_arrays(x, y), axis=-1)
