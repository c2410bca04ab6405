"""Builds small valid scenes from boxes, for tests that need no scene compiler.

The code is simple and slow; it is for tests only.
"""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from schemas.scene import CompiledScene, Instance, SceneInfo, Target
from schemas.terms import TIER_RANGE_M, Tier

Vector3 = tuple[float, float, float]

BODY_RADIUS_M = 0.4
"""A floor cell counts as reachable if its distance to all obstacles is larger than this, metres."""
_CELL_M = 0.05
_BAND_M = (0.05, 1.0)  # heights above the floor that block the robot
_TALL_M = 0.6  # objects above this height block sight
_SUCCESS_M = 1.0


@dataclass(frozen=True)
class Box:
    """A box along the world axes; it is one instance and one part of the scene."""

    low: Vector3
    """Lower corner, metres."""
    high: Vector3
    """Upper corner, metres."""
    colour: tuple[int, int, int] = (160, 160, 160)
    """sRGB."""
    category: str | None = None
    """Category of the target; `None` if the box is not a target."""
    solid: bool = True
    """Whether the box is part of the collider; floors are not."""
    texture: int = -1
    """Index in the textures given to `build_scene`; the texture repeats every metre. -1 for no texture."""


def room_walls(
    low: tuple[float, float], high: tuple[float, float], height: float = 2.5, thickness: float = 0.2
) -> tuple[Box, ...]:
    """Returns a floor slab, its top at height 0, and four walls around the free rectangle from `low` to `high`."""
    (x0, y0), (x1, y1), t = low, high, thickness
    grey, pale = (120, 120, 120), (210, 205, 195)
    return (
        Box((x0 - t, y0 - t, -0.1), (x1 + t, y1 + t, 0.0), grey, solid=False),
        Box((x0 - t, y0 - t, 0.0), (x0, y1 + t, height), pale),
        Box((x1, y0 - t, 0.0), (x1 + t, y1 + t, height), pale),
        Box((x0, y0 - t, 0.0), (x1, y0, height), pale),
        Box((x0, y1, 0.0), (x1, y1 + t, height), pale),
    )


def box_room(extra: Sequence[Box] = ()) -> CompiledScene:
    """Returns a room of 8 x 6 m around the origin with a crate, a barrel, a pillar and the boxes of `extra`."""
    crate = Box((2.2, 1.0, 0.0), (2.8, 1.6, 0.6), (200, 30, 30), category="crate")
    barrel = Box((-3.0, -2.2, 0.0), (-2.5, -1.7, 0.9), (30, 30, 200), category="barrel")
    pillar = Box((-0.2, 1.6, 0.0), (0.2, 2.0, 2.5), (90, 140, 90))
    walls = room_walls((-4.0, -3.0), (4.0, 3.0))
    return build_scene((*walls, crate, barrel, pillar, *extra), name="box_room")


def build_scene(
    boxes: Sequence[Box],
    *,
    name: str = "boxes",
    textures: NDArray[np.uint8] | None = None,
    floor_height_m: float = 0.0,
) -> CompiledScene:
    """Returns a valid scene of boxes: box k is instance k + 1, and target `<category>_<k + 1>` if it has a category.

    Args:
        boxes: all boxes, floor slab included.
        name: name of the scene.
        textures: (L, 512, 512, 3) sRGB textures that the boxes can use.
        floor_height_m: height of the physics floor; the visible floor is one of the boxes.
    """
    grid = _Grid.around(boxes, floor_height_m)
    spawns = grid.spawns()
    targets = [_target(index, box, grid, spawns) for index, box in enumerate(boxes) if box.category]
    layers = () if textures is None else tuple(textures)
    triangles = [_triangles(box) for box in boxes]
    solids = [corners for box, corners in zip(boxes, triangles, strict=True) if box.solid]
    collider_vertices, collider_triangles = _collider(solids)
    return CompiledScene(
        info=_info(name, boxes, [target for target, _ in targets], grid, len(layers), floor_height_m),
        positions=np.concatenate(triangles).astype(np.float32),
        uvs=np.concatenate([_planar_uvs(corners) for corners in triangles]).astype(np.float32),
        colours=np.repeat(np.array([box.colour for box in boxes], np.uint8), 36, axis=0),
        light_uvs=np.empty((0, 2), np.float32),
        light_map=np.empty((0, 0, 3), np.uint8),
        part_first=np.arange(len(boxes), dtype=np.int32) * 36,
        part_count=np.full(len(boxes), 36, np.int32),
        part_instance=np.arange(1, len(boxes) + 1, dtype=np.uint16),
        part_texture=np.array([box.texture for box in boxes], np.int16),
        textures=layers,
        collider_vertices=collider_vertices,
        collider_triangles=collider_triangles,
        occupancy=grid.occupancy,
        reachable=grid.reachable,
        spawns=spawns,
        spawn_sees=np.array([sees for _, sees in targets], np.uint8).reshape(len(targets), len(spawns)).T.copy(),
    )


_FACES = ((0, 4, 6, 2), (1, 3, 7, 5), (0, 1, 5, 4), (2, 6, 7, 3), (0, 2, 3, 1), (4, 5, 7, 6))
"""Numbers of the four corners of each face, counter-clockwise seen from outside. Bit 0 of a corner number selects the
lower or the upper x, bit 1 the y, bit 2 the z."""


def _triangles(box: Box) -> NDArray[np.float64]:
    ends = np.array((box.low, box.high))
    corners = np.array([(ends[k & 1, 0], ends[k >> 1 & 1, 1], ends[k >> 2, 2]) for k in range(8)])
    return np.concatenate([corners[[a, b, c, a, c, d]] for a, b, c, d in _FACES])


def _planar_uvs(corners: NDArray[np.float64]) -> NDArray[np.float64]:
    """Returns texture coordinates in metres for each face; the texture is upright on walls."""
    flat = np.repeat(np.ptp(corners.reshape(6, 6, 3), axis=1).argmin(axis=1), 6)
    across = np.where(flat == 0, corners[:, 1], corners[:, 0])
    return np.column_stack((across, np.where(flat == 2, corners[:, 1], corners[:, 2])))


def _collider(solids: list[NDArray[np.float64]]) -> tuple[NDArray[np.float32], NDArray[np.int32]]:
    corners = np.concatenate(solids) if solids else np.empty((0, 3))
    vertices, indices = np.unique(corners.astype(np.float32), axis=0, return_inverse=True)
    return vertices, indices.reshape(-1, 3).astype(np.int32)


@dataclass(frozen=True)
class _Grid:
    origin: tuple[float, float]
    occupancy: NDArray[np.uint8]
    reachable: NDArray[np.uint8]

    @classmethod
    def around(cls, boxes: Sequence[Box], floor: float) -> _Grid:
        low, high = np.min([box.low for box in boxes], axis=0), np.max([box.high for box in boxes], axis=0)
        columns, rows = np.ceil((high - low)[:2] / _CELL_M - 1e-6).astype(int)
        x, y = low[0] + (np.arange(columns) + 0.5) * _CELL_M, low[1] + (np.arange(rows) + 0.5) * _CELL_M
        occupancy = np.zeros((rows, columns), np.uint8)
        for box in boxes:
            if box.solid and box.low[2] < floor + _BAND_M[1] and box.high[2] > floor + _BAND_M[0]:
                inside = np.outer((y > box.low[1]) & (y < box.high[1]), (x > box.low[0]) & (x < box.high[0]))
                level = 2 if box.high[2] >= floor + _TALL_M else 1
                occupancy = np.maximum(occupancy, np.where(inside, level, 0)).astype(np.uint8)
        return cls((float(low[0]), float(low[1])), occupancy, _largest_open_area(occupancy))

    def holds(self, points: NDArray[np.float64]) -> NDArray[np.bool_]:
        """Returns whether each of the (N, 2) points is on reachable floor."""
        column, row = np.floor((points - self.origin) / _CELL_M).astype(int).T
        rows, columns = self.reachable.shape
        known = (row >= 0) & (row < rows) & (column >= 0) & (column < columns)
        on_floor: NDArray[np.bool_] = known & (self.reachable[row.clip(0, rows - 1), column.clip(0, columns - 1)] > 0)
        return on_floor

    def spawns(self) -> NDArray[np.float32]:
        """Returns the points of a half-metre grid that are reachable."""
        rows, columns = self.reachable.shape
        lattice = np.array([(x, y) for y in range(5, rows, 10) for x in range(5, columns, 10)], np.float64)
        points = np.array(self.origin) + (lattice.reshape(-1, 2) + 0.5) * _CELL_M
        return points[self.holds(points)].astype(np.float32)


def _largest_open_area(occupancy: NDArray[np.uint8]) -> NDArray[np.uint8]:
    walled = np.pad(occupancy == 0, 1)
    clear = ndimage.distance_transform_edt(walled)[1:-1, 1:-1] * _CELL_M > BODY_RADIUS_M
    labels, count = ndimage.label(clear)
    if count == 0:
        return np.zeros_like(occupancy)
    sizes = np.bincount(labels.ravel())[1:]
    largest = labels == 1 + int(sizes.argmax())
    return np.asarray(largest, np.uint8)


def _target(index: int, box: Box, grid: _Grid, spawns: NDArray[np.float32]) -> tuple[Target, NDArray[np.uint8]]:
    low, high = np.array(box.low), np.array(box.high)
    centre = (low + high) / 2
    sees = _are_straight_free(grid, spawns, centre[:2]).astype(np.uint8)
    distances = np.linalg.norm(spawns - centre[:2], axis=1)
    assert box.category is not None
    target = Target(
        target_id=f"{box.category}_{index + 1}",
        category=box.category,
        instance_id=index + 1,
        prim_path=f"/World/Box_{index + 1}",
        centroid_m=tuple(centre.tolist()),
        size_m=tuple((high - low).tolist()),
        straight_tiers=_tiers(distances[sees > 0]),
        connected_tiers=_tiers(distances),
        footprint_m=(tuple(low[:2]), (high[0], low[1]), tuple(high[:2]), (low[0], high[1])),
        surface_straight_tiers=_tiers(distances[sees > 0]),
        surface_connected_tiers=_tiers(distances),
    )
    return target, sees


def _are_straight_free(grid: _Grid, spawns: NDArray[np.float32], centre: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Returns whether each of the (N, 2) starts has a straight path on reachable floor to the success radius."""
    gaps = centre - spawns
    distances = np.linalg.norm(gaps, axis=1)[:, None]
    steps = np.arange(0.0, distances.max(initial=0.0), _CELL_M)
    ways = spawns[:, None] + steps[:, None] * gaps[:, None] / np.maximum(distances, _SUCCESS_M)[:, None]
    is_free: NDArray[np.bool_] = grid.holds(ways.reshape(-1, 2)).reshape(ways.shape[:2]) | (
        steps >= distances - _SUCCESS_M
    )
    return (distances[:, 0] > _SUCCESS_M) & is_free.all(axis=1)


def _tiers(distances: NDArray[np.floating]) -> tuple[Tier, ...]:
    near_mid = [tier for tier, (low, high) in TIER_RANGE_M.items() if ((distances >= low) & (distances <= high)).any()]
    return (*near_mid, Tier.FAR) if distances.size else ()


def _info(
    name: str, boxes: Sequence[Box], targets: list[Target], grid: _Grid, layers: int, floor_height_m: float
) -> SceneInfo:
    low, high = np.min([box.low for box in boxes], axis=0), np.max([box.high for box in boxes], axis=0)
    return SceneInfo(
        name=name,
        source="boxes of a test",
        source_sha256=hashlib.sha256(repr((boxes, layers, floor_height_m)).encode()).hexdigest(),
        metres_per_unit=1.0,
        bounds_m=(tuple(low.tolist()), tuple(high.tolist())),
        grid_origin_m=grid.origin,
        grid_resolution_m=_CELL_M,
        targets=tuple(targets),
        instances=tuple(
            Instance(id=index + 1, prim_path=f"/World/Box_{index + 1}", category=box.category)
            for index, box in enumerate(boxes)
        ),
        texture_count=layers,
        floor_height_m=floor_height_m,
        free_area_m2=float(grid.reachable.sum()) * _CELL_M**2,
    )
