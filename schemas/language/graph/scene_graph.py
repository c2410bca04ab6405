"""Scene graph: the objects of a compiled scene that words can name, with their geometry, rooms, walls and tops.

Computed once for each scene. Does not interpret expressions and decides nothing about words.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from schemas.language.graph.objects import RawObject, find_objects
from schemas.language.graph.rooms import (
    THRESHOLD_M,
    WIDE_M,
    CellGrid,
    SceneRoom,
    divide_rooms,
    find_walls,
    nearest_room,
    opening_gaps,
    wall_gaps,
)
from schemas.language.kinds import UNNAMED, Kinds, kinds
from schemas.language.thresholds import TOUCH_M
from schemas.scene import CompiledScene, SceneInfo
from schemas.support.numpy_types import Bools, Floats, Ints

_WALL = 2
_FAR_M = 7.0
"""Distance between the middles of two objects beyond which no line is traced, metres."""
_END_M = 0.06
"""Width of a margin around both objects, metres; a wall within it does not count as a wall between them."""
_SAMPLES = 128
_CHUNK = 4096


def find_barriers(low: Floats, high: Floats, sight: CellGrid) -> Bools:
    """Returns the (N, N) pairs of objects with a wall between them, omitting pairs whose middles are 7 m or more apart.

    Args:
        low: (N, 2) lower corners of the bounding rectangles, metres.
        high: (N, 2) upper corners, metres.
        sight: grid with the value 2 in the cells of walls.
    """
    middle, has_barrier = (low + high) / 2, np.zeros((len(low), len(low)), bool)
    one, two = np.triu_indices(len(low), 1)
    near = np.hypot(*(middle[one] - middle[two]).T) < _FAR_M
    one, two = one[near], two[near]
    share = ((np.arange(_SAMPLES) + 0.5) / _SAMPLES)[:, None]
    for begin in range(0, len(one), _CHUNK):
        a, b = one[begin : begin + _CHUNK], two[begin : begin + _CHUNK]
        points = middle[a, None] + share * (middle[b] - middle[a])[:, None]
        wall = np.asarray(sight.at(points) == _WALL)
        for end in (a, b):
            inside = (points > low[end, None] - _END_M) & (points < high[end, None] + _END_M)
            wall &= ~inside.all(axis=-1)
        has_barrier[a, b] = has_barrier[b, a] = wall.any(axis=1)
    return has_barrier


_FLAT_M, _FLAT_SHARE, _UPRIGHT = 0.02, 0.6, 0.98
"""A top is flat if faces within the height `_FLAT_M` (metres) below it, whose unit normals have a z above `_UPRIGHT`,
cover the share `_FLAT_SHARE` of the footprint."""
_ABOVE_M = 0.6
"""Height of the space above a top, metres. A top is empty only if no other instance reaches into this space."""
_EDGE_M = 0.03
"""Width at the edge of a top that is not examined, because walls and other furniture touch it, metres."""

Corner = tuple[float, float, float]


@dataclass(frozen=True)
class SurfaceTop:
    """Flat upper side of an object."""

    height_m: float
    """z in the world frame, metres."""
    above: tuple[tuple[Corner, Corner], ...]
    """Lower and upper corners of the boxes around all other instances with a face in the space above it, metres."""


def find_tops(scene: CompiledScene, objects: Mapping[int, tuple[Sequence[int], Floats]]) -> dict[int, SurfaceTop]:
    """Returns the flat tops of objects; objects without one are omitted.

    Args:
        scene: compiled scene.
        objects: number of each object -> instance ids of its parts, and vertices (K, 2) of its footprint, metres.
    """
    if not objects:
        return {}
    # of all instances, also those that no word names: a table with papers on it is not empty
    faces = scene.positions.reshape(-1, 3, 3).astype(np.float64)
    order = np.argsort(scene.part_first, kind="stable")
    owner = np.repeat(scene.part_instance[order].astype(np.int64), scene.part_count[order] // 3)
    low, high = faces.min(axis=1), faces.max(axis=1)
    tops = {number: _top_of(faces, low, high, owner, *ids) for number, ids in objects.items()}
    return {number: top for number, top in tops.items() if top is not None}


def _top_of(
    faces: Floats, low: Floats, high: Floats, owner: Ints, ids: Sequence[int], outline: Floats
) -> SurfaceTop | None:
    is_own = np.isin(owner, ids)
    if not is_own.any():
        return None
    floor, top = low[is_own].min(axis=0), high[is_own].max(axis=0)
    ahead = np.roll(outline, -1, axis=0)
    area = float(outline[:, 0] @ ahead[:, 1] - ahead[:, 0] @ outline[:, 1]) / 2
    if not _is_flat_top(faces[is_own], float(top[2]), area):
        return None
    inside = (low[:, :2] < top[:2] - _EDGE_M).all(axis=1) & (high[:, :2] > floor[:2] + _EDGE_M).all(axis=1)
    inside &= (low[:, 2] < top[2] + _ABOVE_M) & (high[:, 2] > top[2] + _FLAT_M) & ~is_own
    boxes = [_box(low, high, owner == number) for number in np.unique(owner[inside]).tolist()]
    return SurfaceTop(float(top[2]), tuple(boxes))


def _is_flat_top(faces: Floats, top_m: float, area_m2: float) -> bool:
    """Returns whether horizontal faces at the top cover most of the area of the footprint."""
    level = faces[(faces[:, :, 2] > top_m - _FLAT_M).all(axis=1)]
    normal = np.cross(level[:, 1] - level[:, 0], level[:, 2] - level[:, 0])
    length = np.maximum(np.linalg.norm(normal, axis=1), 1e-12)
    upright = normal[:, 2] / length > _UPRIGHT
    return float(normal[upright, 2].sum()) / 2 >= _FLAT_SHARE * area_m2


def _box(low: Floats, high: Floats, chosen: Bools) -> tuple[Corner, Corner]:
    (x0, y0, z0), (x1, y1, z1) = low[chosen].min(axis=0).tolist(), high[chosen].max(axis=0).tolist()
    return (x0, y0, z0), (x1, y1, z1)


_LOW_M, _TALL_M = 0.6, 1.6
_BETWEEN_ROOMS = frozenset({"door", "gate", "window"})
_BESIDE_M = (0.1, 0.13, 0.16, 0.2)
"""Distances from the faces of a door leaf at which a wall is searched, metres. There are several, because a wall may
consist of two thin faces."""


@dataclass(frozen=True)
class SceneObject:
    """Object of a scene graph."""

    ids: tuple[int, ...]
    """Instance ids of its parts."""
    kind: str
    """Category, special kind of a category, or kind of a landmark."""
    colour: str
    """Dominant colour, or `unknown`."""
    low_m: tuple[float, float, float]
    """Lower corner of its bounding box, metres."""
    high_m: tuple[float, float, float]
    """Upper corner of its bounding box, metres."""
    outline_m: tuple[tuple[float, float], ...]
    """Vertices x, y of its footprint, counter-clockwise, metres; the bounding rectangle if none is recorded."""
    target_id: str | None
    """Target id of the object; `None` if it is not a target."""
    room: int
    """Number of its room; 0 if unknown or between rooms."""
    wall_gap_m: float
    """Gap between its footprint and the nearest wall, metres; at most 4."""
    corner_gap_m: float
    """Smallest distance from its footprint within which there are two perpendicular walls, metres."""
    base_m: float
    """Height of its lower side above the floor, metres."""
    looks: str | None = None
    """Kind in the name of its prim, if it differs from `kind` and a viewer may see the object as that kind."""
    shows: tuple[str, ...] = ()
    """Kinds for which a viewer may mistake it or a part of it; for example, the screen of a till looks like a
    monitor."""
    area: int = 0
    """Number of the part of its room; wide openings divide a room into parts. 0 if unknown."""
    materials: tuple[str, ...] = ()
    """Recorded materials: first the material of most of its surface, then other visible ones; empty if unknown."""
    top: SurfaceTop | None = None
    """Flat upper side; `None` if the object has none or nothing can be put on its kind."""


@dataclass(frozen=True)
class SceneGraph:
    """Objects, rooms and walls of a scene."""

    objects: tuple[SceneObject, ...]
    """All objects that words can name."""
    rooms: tuple[SceneRoom, ...]
    """Rooms of the scene."""
    types: tuple[str | None, ...]
    """Type of each room, or `None`."""
    room_grid: CellGrid
    """Number of the room of each cell."""
    area_grid: CellGrid
    """Number of the part of a room at each cell; wide openings divide a room into parts. 0 close to an opening."""
    sight_grid: CellGrid
    """0 free, 1 occupied by an object, 2 wall."""
    floor_m: float
    """Height of the floor, metres."""
    kinds: Kinds
    """Kinds with which the graph was built."""

    @cached_property
    def low(self) -> Floats:
        """(N, 3) lower corners, metres."""
        return np.array([each.low_m for each in self.objects]).reshape(-1, 3)

    @cached_property
    def high(self) -> Floats:
        """(N, 3) upper corners, metres."""
        return np.array([each.high_m for each in self.objects]).reshape(-1, 3)

    @cached_property
    def room_of(self) -> Ints:
        """(N,) room of each object, 0 if unknown."""
        return np.array([each.room for each in self.objects], np.int64)

    @cached_property
    def area_of(self) -> Ints:
        """(N,) part of a room of each object, 0 if unknown."""
        return np.array([each.area for each in self.objects], np.int64)

    @cached_property
    def hangs(self) -> Bools:
        """(N,) objects that hang on a wall or above a door, so they are seen from one side only."""
        gaps = np.array([min(each.wall_gap_m, each.high_m[0] - each.low_m[0]) for each in self.objects])
        thin = np.minimum(gaps, (self.high - self.low)[:, 1]) <= TOUCH_M.bad
        return np.asarray(thin & (np.array([each.base_m for each in self.objects]) > TOUCH_M.bad))

    @cached_property
    def walled(self) -> Bools:
        """(N, N) pairs of objects with a wall between them; pairs with an object whose room is unknown, such as a door,
        are omitted."""
        is_known = (self.room_of > 0) & (self.room_of > 0)[:, None]
        return find_barriers(self.low[:, :2], self.high[:, :2], self.sight_grid) & is_known

    def areas_of_type(self, room: int, kind: str) -> frozenset[int]:
        """Returns the parts of a room that show its type.

        If objects define the type, these are the parts that contain such an object. Otherwise, the shape of the room
        defines it: the result is the only part of the room, or empty if the room has several parts.
        """
        areas = frozenset(each.area for each in self.objects if each.room == room)
        shown = self.kinds.rooms[kind].has
        held = frozenset(each.area for each in self.objects if each.room == room and each.kind in shown)
        return (held if shown else areas if len(areas) == 1 else frozenset()) - {0}

    @cached_property
    def number_of(self) -> dict[str, int]:
        """Number in `objects` of each object that is a target, by target id."""
        return {each.target_id: number for number, each in enumerate(self.objects) if each.target_id is not None}

    def room_at(self, x: float, y: float) -> int:
        """Returns the room at a point, or 0."""
        return self.room_grid.label_at(x, y)

    def area_at(self, x: float, y: float) -> int:
        """Returns the part of a room at a point; 0 if it is unknown or close to an opening."""
        return self.area_grid.label_at(x, y)

    def unique_room(self, kind: str) -> int:
        """Returns the only room of a type; 0 if there is none or several."""
        labels = [room.label for room, room_type in zip(self.rooms, self.types, strict=True) if room_type == kind]
        return labels[0] if len(labels) == 1 else 0


def build_graph(scene: CompiledScene) -> SceneGraph:
    table, info = kinds(), scene.info
    raw = find_objects(scene, table)
    occupancy = CellGrid(scene.occupancy, info.grid_origin_m, info.grid_resolution_m)
    placed = [each for each in raw if each.kind not in (*_BETWEEN_ROOMS, UNNAMED)]
    boxes = np.array([_covered(each, info) for each in placed if not _is_flat(each, info)])
    walls = find_walls(occupancy, boxes.reshape(-1, 2, 2))
    inside = _building(scene)
    room_grid, rooms = divide_rooms(walls, inside)
    area_grid, _ = divide_rooms(walls, inside, WIDE_M)
    centres = np.array([(each.low[:2] + each.high[:2]) / 2 for each in raw]).reshape(-1, 2)
    gaps, corners = wall_gaps(walls, centres, [each.outline for each in raw])
    labels, areas = nearest_room(room_grid, centres), nearest_room(area_grid, centres)
    surfaces = {n: (each.ids, each.outline) for n, each in enumerate(raw) if table.of(each.kind).surface}
    tops = find_tops(scene, surfaces)
    objects = tuple(
        SceneObject(
            ids=each.ids,
            kind=each.kind,
            colour=each.colour,
            low_m=(float(each.low[0]), float(each.low[1]), float(each.low[2])),
            high_m=(float(each.high[0]), float(each.high[1]), float(each.high[2])),
            outline_m=tuple((float(x), float(y)) for x, y in each.outline),
            target_id=each.target_id,
            room=_room_of_leaf(each, walls, room_grid) if each.kind in _BETWEEN_ROOMS else int(labels[number]),
            wall_gap_m=float(gaps[number]),
            corner_gap_m=float(corners[number]),
            base_m=float(each.low[2]) - info.floor_height_m,
            looks=each.looks,
            shows=each.shows,
            area=int(areas[number]),
            materials=each.materials if table.of(each.kind).material else (),
            top=tops.get(number),
        )
        for number, each in enumerate(raw)
    )
    types = tuple(_room_type(room, objects, table) for room in rooms)
    sight = np.where(walls.values, 2, scene.occupancy > 0).astype(np.uint8)
    sight_grid = occupancy._replace(values=sight)
    inner = np.where(opening_gaps(walls, WIDE_M) < THRESHOLD_M, 0, area_grid.values)
    inner_grid = area_grid._replace(values=inner)
    return SceneGraph(
        objects,
        rooms,
        types=types,
        room_grid=room_grid,
        area_grid=inner_grid,
        sight_grid=sight_grid,
        floor_m=info.floor_height_m,
        kinds=table,
    )


def _room_of_leaf(each: RawObject, walls: CellGrid, room_grid: CellGrid) -> int:
    """Returns the room of an open door leaf in front of a wall; 0 for a leaf in its doorway, and for other objects."""
    if each.kind != "door":
        return 0
    across = int(each.high[1] - each.low[1] < each.high[0] - each.low[0])
    middle, half = (each.low[:2] + each.high[:2]) / 2, (each.high[across] - each.low[across]) / 2
    offsets = np.zeros((len(_BESIDE_M), 2))
    offsets[:, across] = half + np.array(_BESIDE_M)
    free = [side for side in (-1, 1) if not np.any(walls.at(middle + side * offsets))]
    return int(room_grid.at(middle + free[0] * offsets[-1])) if len(free) == 1 else 0


def _is_tall(each: RawObject, info: SceneInfo) -> bool:
    """Returns whether an object on the floor blocks the view."""
    return bool(each.low[2] - info.floor_height_m < _LOW_M and each.high[2] - info.floor_height_m > _TALL_M)


def _is_flat(each: RawObject, info: SceneInfo) -> bool:
    """Returns whether an object is low or hangs, and is thinner than two cells, such as a picture: its cells belong to
    the wall behind it."""
    thin = float((each.high[:2] - each.low[:2]).min()) < 2 * info.grid_resolution_m
    return thin and not _is_tall(each, info)


def _covered(each: RawObject, info: SceneInfo) -> Floats:
    """Returns the lower and upper corner of the rectangle in which occupied cells belong to an object, not to a wall.

    For a tall object on the floor, it includes the cells at the edges; for a low or hanging one, it excludes them.
    """
    margin = info.grid_resolution_m / 2 * (1 if _is_tall(each, info) else -1)
    return np.stack((each.low[:2] - margin, each.high[:2] + margin))


def _building(scene: CompiledScene) -> Bools:
    """Returns the cells within the bounds of the visible geometry."""
    info, (rows, columns) = scene.info, scene.occupancy.shape
    (x0, y0, _), (x1, y1, _) = info.bounds_m
    x = info.grid_origin_m[0] + (np.arange(columns) + 0.5) * info.grid_resolution_m
    y = info.grid_origin_m[1] + (np.arange(rows) + 0.5) * info.grid_resolution_m
    return np.outer((y > y0) & (y < y1), (x > x0) & (x < x1))


def _room_type(room: SceneRoom, objects: tuple[SceneObject, ...], table: Kinds) -> str | None:
    held = [each.kind for each in objects if each.room == room.label]
    for name, rule in table.rooms.items():
        if rule.aspect is not None:
            if room.aspect >= rule.aspect:
                return name
        elif sum(kind in rule.has for kind in held) >= rule.count:
            return name
    return None
