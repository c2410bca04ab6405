"""Finds the doorways between the rooms of a scene graph, and where a path changes rooms. Names nothing."""

from __future__ import annotations

from itertools import pairwise
from typing import NamedTuple

import numpy as np
import scipy  # imports `scipy.ndimage` at its first use

from schemas.language.graph.scene_graph import SceneGraph
from schemas.language.route.meaning import DrivenPath
from schemas.language.route.thresholds import DOORWAY_M
from schemas.support.numpy_types import Floats

_MARGIN_M = 0.2
"""Minimum distance between a cell of a passage and the nearest wall or object, metres."""
_MEANT_M = 0.4
"""Minimum length of the stretch of a path within a room that counts as a visit to the room, metres. A shorter stretch
is an artefact of the grid."""
_OWN_M = 1.5
"""Largest distance between the middle of a doorway and the path through it, metres."""


class RoomPassage(NamedTuple):
    """Passage between two rooms."""

    middle: tuple[float, float]
    """x, y, metres."""
    rooms: frozenset[int]
    """Numbers of both rooms."""
    width_m: float
    """Largest extent along the axes of the grid, metres."""


class RoomChange(NamedTuple):
    """Change of rooms along a path."""

    frame: int
    """First frame in the new room."""
    before: int
    """Number of the room before."""
    after: int
    """Number of the new room."""


def find_doorways(graph: SceneGraph) -> tuple[RoomPassage, ...]:
    """Returns the passages between two rooms: openings that `divide_rooms` closed, and borders of adjacent rooms."""
    labels = np.asarray(graph.room_grid.values, np.int64)
    resolution, origin = graph.room_grid.resolution_m, np.asarray(graph.room_grid.origin_m)
    clearance = scipy.ndimage.distance_transform_edt(np.asarray(graph.sight_grid.values) == 0) * resolution
    passable = clearance > _MARGIN_M  # excludes the space within hollow walls
    border = np.zeros(labels.shape, bool)
    for axis in (0, 1):
        one, two = (np.take(labels, range(part, labels.shape[axis] - 1 + part), axis) for part in (0, 1))
        differs = (one != two) & (one > 0) & (two > 0)
        border |= np.pad(differs, [(0, int(axis == 0)), (0, int(axis == 1))])
    between, _ = scipy.ndimage.label((border | (labels == 0)) & passable, np.ones((3, 3)))
    doorways = []
    for number, part in enumerate(scipy.ndimage.find_objects(between), 1):
        grown = tuple(slice(max(0, side.start - 2), side.stop + 2) for side in part)
        cells = between[grown] == number
        touched = labels[grown][scipy.ndimage.binary_dilation(cells, iterations=2)]
        rooms = frozenset(int(room) for room in np.unique(touched) if room)
        if len(rooms) == 2:
            corner = np.array([side.start for side in grown])
            middle = origin + (np.argwhere(cells).mean(axis=0) + corner + 0.5)[::-1] * resolution
            width = max(side.stop - side.start for side in part) * resolution + 2 * _MARGIN_M
            doorways.append(RoomPassage((float(middle[0]), float(middle[1])), rooms, width))
    return tuple(doorways)


def room_changes(graph: SceneGraph, path: DrivenPath) -> list[RoomChange]:
    """Returns where a path enters another room and stays there for a while."""
    labels = np.asarray(graph.room_grid.at(path.xy), np.int64)
    frames = np.flatnonzero(labels)
    stays: list[tuple[int, int]] = []
    for stay in np.split(frames, np.flatnonzero(np.diff(labels[frames])) + 1) if len(frames) else ():
        first, last = int(stay[0]), int(stay[-1])
        is_meant = path.along[last] - path.along[first] >= _MEANT_M or first == int(frames[0])
        if is_meant and (not stays or stays[-1][1] != labels[first]):
            stays.append((first, int(labels[first])))
    return [RoomChange(frame, before, after) for (_, before), (frame, after) in pairwise(stays)]


def doorway_of(doorways: tuple[RoomPassage, ...], change: RoomChange, place: Floats) -> RoomPassage | None:
    """Returns the doorway through which a path changes rooms at a point x, y; `None` if the passage is wide or
    unknown."""
    passages = [each for each in doorways if each.rooms == {change.before, change.after}]
    nearest = min(passages, key=lambda each: float(np.hypot(*(place - each.middle))), default=None)
    if nearest is None or np.hypot(*(place - nearest.middle)) > _OWN_M or nearest.width_m > DOORWAY_M.good:
        return None
    return nearest
