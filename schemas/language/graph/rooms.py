"""Divides the floor of a scene into rooms, and measures the distance of objects to walls. Pure functions of the grid.

Openings between two collinear walls are closed. Rooms are the components of the floor farther than half a door from
every wall, grown back to the walls: morphological segmentation (Bormann et al., Room Segmentation: Survey,
Implementation, and Analysis, ICRA 2016).
"""

from __future__ import annotations

import math
from itertools import pairwise
from typing import NamedTuple

import numpy as np
import scipy  # imports `scipy.ndimage` at its first use
from numpy.typing import NDArray

from schemas.support.numpy_types import Bools, Floats, Ints

OPENING_M = 2.4
"""Largest width of an opening in a wall along the axes of the grid, metres; a wider one does not divide a room."""
WIDE_M = 5.0
"""Largest width of an opening that a viewer may take for the boundary of a room, metres."""
THRESHOLD_M = 0.5
"""Distance from an opening within which a viewer may be in either room, metres."""
DOOR_M = 1.3
"""Largest width of a door in any direction, metres."""
MIN_ROOM_M2 = 3.0
"""Smallest area of a room, square metres."""
_SMALLEST_WALL_M = 1.0
_SHORTEST_RUN_M = 0.4
_FAR_M = 4.0
_DIRECTIONS = 12
_CAVITY_CELLS = 3
"""Largest gap in a hollow wall, cells. A wall is hollow if a scene has its two surfaces and nothing in between."""
# with cells of 0.05 m, walls up to 0.2 m thick are filled; the built-in walls are 0.12 m thick
_FLAT_M, _AT_WALL_M, _FRONT_M = 0.1, 0.15, 0.1
_HIDING = 2


class CellGrid(NamedTuple):
    """Grid of cells in the world frame."""

    values: NDArray[np.generic]
    """(H, W) values; rows are y."""
    origin_m: tuple[float, float]
    """World x, y of the outer corner of cell (0, 0), metres."""
    resolution_m: float
    """Side of a cell, metres."""

    def cells(self, points: Floats) -> tuple[Ints, Ints]:
        """Returns rows and columns of (..., 2) world points, clipped to the grid."""
        index = np.floor((points - np.asarray(self.origin_m)) / self.resolution_m).astype(np.int64)
        rows, columns = self.values.shape
        return np.clip(index[..., 1], 0, rows - 1), np.clip(index[..., 0], 0, columns - 1)

    def label_at(self, x: float, y: float) -> int:
        """Returns the integer value at one world point."""
        rows, columns = self.values.shape
        row = math.floor((y - self.origin_m[1]) / self.resolution_m)
        column = math.floor((x - self.origin_m[0]) / self.resolution_m)
        return int(self.values[min(max(row, 0), rows - 1), min(max(column, 0), columns - 1)])

    def at(self, points: Floats) -> NDArray[np.generic]:
        """Returns the values at (..., 2) world points."""
        return np.asarray(self.values[self.cells(points)])


def opening_gaps(walls: CellGrid, opening_m: float) -> Floats:
    """Returns (H, W) distances of the cells to the nearest opening between two collinear walls, metres.

    Args:
        walls: grid of walls.
        opening_m: largest width of an opening, metres.
    """
    filled = np.asarray(walls.values, bool)
    openings = _close_openings(filled, walls.resolution_m, opening_m) & ~filled
    if not openings.any():
        return np.full(filled.shape, np.inf)
    return np.asarray(scipy.ndimage.distance_transform_edt(~openings) * walls.resolution_m)


class SceneRoom(NamedTuple):
    """Room of a scene."""

    label: int
    """Number, from 1."""
    area_m2: float
    """Area of its free floor, square metres."""
    aspect: float
    """Longer side of its bounding rectangle along the world axes, divided by the shorter side."""


def find_walls(occupancy: CellGrid, boxes: Floats) -> CellGrid:
    """Returns the grid of walls: cells that block the view, outside of the boxes of objects.

    Components shorter than `_SMALLEST_WALL_M` are omitted.

    Args:
        occupancy: 0 free, 1 occupied, 2 occupied and blocking the view.
        boxes: (N, 2, 2) lower and upper corner x, y of each object, metres.
    """
    walls = occupancy.values == _HIDING
    for box in boxes:
        (row0, row1), (column0, column1) = occupancy.cells(box)
        walls[row0 : row1 + 1, column0 : column1 + 1] = False
    labels, _ = scipy.ndimage.label(walls, np.ones((3, 3)))
    least = _SMALLEST_WALL_M / occupancy.resolution_m
    for number, part in enumerate(scipy.ndimage.find_objects(labels), 1):
        if max(side.stop - side.start for side in part) < least:
            walls[part][labels[part] == number] = False
    return occupancy._replace(values=_without_cavities(walls))


def _without_cavities(walls: Bools) -> Bools:
    """Returns the walls with hollow walls filled: gaps of up to `_CAVITY_CELLS` cells between two wall cells, along
    both axes."""
    filled = walls.copy()
    for axis in (0, 1):
        for width in range(1, _CAVITY_CELLS + 1):
            before, after = (np.roll(walls, step, axis) for step in (width, -1))
            ends = before & after
            for step in range(width):
                filled |= np.roll(ends, -step, axis)
    return filled


def divide_rooms(
    walls: CellGrid, inside: Bools, opening_m: float = OPENING_M
) -> tuple[CellGrid, tuple[SceneRoom, ...]]:
    """Returns the number of the room of each cell, 0 outside of rooms, and the rooms.

    Args:
        walls: grid of walls.
        inside: (H, W) cells within the building.
        opening_m: largest width of an opening between two collinear walls that divides a room, metres.
    """
    free = inside & ~_close_openings(np.asarray(walls.values, bool), walls.resolution_m, opening_m)
    clearance = scipy.ndimage.distance_transform_edt(np.pad(free, 1))[1:-1, 1:-1] * walls.resolution_m
    seeds, count = scipy.ndimage.label(clearance > DOOR_M / 2)
    cost = np.where(free, 1, 255).astype(np.uint8)
    markers = seeds.astype(np.int32)
    markers[~free] = -1
    grown = scipy.ndimage.watershed_ift(cost, markers) if count else np.zeros_like(markers)
    grown = np.where(free & (grown > 0), grown, 0)
    rooms: list[SceneRoom] = []
    labels = np.zeros_like(grown)
    for number, part in enumerate(scipy.ndimage.find_objects(grown), 1):
        cells = grown[part] == number if part is not None else np.zeros(0)
        area = float(cells.sum()) * walls.resolution_m**2
        if part is None or area < MIN_ROOM_M2:
            continue
        height, width = (side.stop - side.start for side in part)
        rooms.append(SceneRoom(len(rooms) + 1, area, max(height, width) / min(height, width)))
        labels[part][cells] = len(rooms)
    return walls._replace(values=labels), tuple(rooms)


def _close_openings(walls: Bools, resolution_m: float, opening_m: float) -> Bools:
    """Returns the walls with filled gaps of at most `opening_m` between collinear runs of cells, along both axes."""
    longest, least = opening_m / resolution_m, _SHORTEST_RUN_M / resolution_m
    closed = walls.copy()
    for lines, filled in ((walls, closed), (walls.T, closed.T)):
        for line, target in zip(lines, filled, strict=True):
            edges = np.flatnonzero(np.diff(np.concatenate(([False], line, [False])).astype(np.int8)))
            runs = [(start, stop) for start, stop in edges.reshape(-1, 2).tolist() if stop - start >= least]
            for (_, stop), (start, _) in pairwise(runs):
                if start - stop <= longest:
                    target[stop:start] = True
    return closed


def nearest_room(rooms: CellGrid, points: Floats, within_m: float = 0.6) -> Ints:
    """Returns the room at each of (N, 2) points; for a point outside of rooms, the nearest room within `within_m`, or
    0."""
    labels = np.asarray(rooms.values, np.int64)
    distance, nearest = scipy.ndimage.distance_transform_edt(labels == 0, return_indices=True)
    row, column = rooms.cells(points)
    nearest_rooms = labels[tuple(axis[row, column] for axis in nearest)]
    return np.where(distance[row, column] * rooms.resolution_m <= within_m, nearest_rooms, 0)


def wall_gaps(walls: CellGrid, centres: Floats, outlines: list[Floats]) -> tuple[Floats, Floats]:
    """Returns (N,) gaps of objects to their nearest wall, and to a wall perpendicular to it, metres; at most 4.

    Objects in a corner have two small gaps. Walls are searched in directions 0, 30, ... 330 degrees. For a
    flat object at a wall, the perpendicular wall is searched in front of it, where its own wall is not in the way.

    Args:
        walls: grid of walls.
        centres: (N, 2) centres of the objects, metres.
        outlines: vertices (K, 2) of the footprint of each object, metres.
    """
    angle = np.arange(_DIRECTIONS) * (2 * np.pi / _DIRECTIONS)
    ways = np.column_stack((np.cos(angle), np.sin(angle)))
    reach = np.array(
        [((outline - centre) @ ways.T).max(axis=0) for centre, outline in zip(centres, outlines, strict=True)]
    ).reshape(-1, _DIRECTIONS)
    wall_gap = _gaps(walls, centres, ways, reach)
    ahead = _gaps(walls, _in_front(walls, centres, ways=ways, reach=reach, gaps=wall_gap), ways, reach)
    # the normal of the wall is the direction in which the centre is nearest to it; a corner of the outline may be
    # nearest to a wall in a different direction
    rows, normal, quarter = np.arange(len(wall_gap)), (ahead + reach).argmin(axis=1), _DIRECTIONS // 4
    gap = wall_gap[rows, (wall_gap + reach).argmin(axis=1)]
    sides = np.minimum(ahead[rows, (normal + quarter) % _DIRECTIONS], ahead[rows, normal - quarter])
    return np.asarray(gap), np.asarray(np.maximum(sides, gap))


def _gaps(walls: CellGrid, points: Floats, ways: Floats, reach: Floats) -> Floats:
    """Returns (N, D) distances from the edge of each object to the first wall in each direction, metres. `reach` (N, D)
    is the distance from an object's point in `points` (N, 2) to its edge in each direction."""
    steps = np.arange(0.0, _FAR_M, walls.resolution_m / 2)
    gaps = np.full(reach.shape, _FAR_M)
    for direction, way in enumerate(ways):
        along = reach[:, direction, None] + steps
        hit = walls.at(points[:, None, :] + along[..., None] * way).astype(bool)
        gaps[:, direction] = np.where(hit.any(axis=1), steps[hit.argmax(axis=1)], _FAR_M)
    return gaps


def _in_front(walls: CellGrid, points: Floats, ways: Floats, reach: Floats, gaps: Floats) -> Floats:
    """Returns the (N, 2) points; the points of flat objects at a wall are moved to `_FRONT_M` in front of the wall."""
    rows, thin = np.arange(len(points)), reach.argmin(axis=1)
    is_at_wall = (reach[rows, thin] < _FLAT_M / 2) & (gaps.min(axis=1) <= _AT_WALL_M)
    steps = np.arange(0.0, _FRONT_M, walls.resolution_m / 2)
    sides = [(thin + turn) % _DIRECTIONS for turn in (0, _DIRECTIONS // 2)]
    depth = []
    for side in sides:  # distance from the point to the edge of the wall
        free = ~walls.at(points[:, None, :] + steps[:, None] * ways[side][:, None, :]).astype(bool)
        depth.append(np.where(free.any(axis=1), steps[free.argmax(axis=1)], _FAR_M))
    is_first = (depth[0] < depth[1]) | ((depth[0] == depth[1]) & (gaps[rows, sides[0]] >= gaps[rows, sides[1]]))
    side = np.where(is_first, *sides)
    length = np.where(is_first, *depth)
    is_moved = is_at_wall & (length < _FAR_M)
    return np.where(is_moved[:, None], points + ways[side] * (length + _FRONT_M)[:, None], points)
