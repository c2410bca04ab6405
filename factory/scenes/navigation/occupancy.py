"""Rasterises triangles of a height band into the occupancy grid: outlines by sampling, interiors by interpolation.

Pure functions. Does not compute reachability.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import binary_closing

from factory.scenes.navigation.floor import floor_triangles
from schemas.errors import WorldError
from schemas.support.numpy_types import Bools, Floats
from workers.geometry.grid import FREE, HIDING, OCCUPIED

BAND_M = (0.05, 0.60)
"""Height band above the floor in which the robot (0.556 m) can collide, metres."""
_HIDING_BANDS_M = ((0.30, 0.60), (1.00, 1.15), (1.65, 1.80))
"""Height bands above the floor, metres; geometry in all three occludes like a wall."""
RESOLUTION_M = 0.05
_PAD_M = 0.5
_FLOOR_BEYOND_M = 6.0
_MAX_CELLS = 16_000_000


@dataclass(frozen=True)
class GridFrame:
    """Origin and shape of a grid."""

    origin_m: tuple[float, float]
    """World x, y of the outer corner of cell (0, 0)."""
    resolution_m: float
    shape: tuple[int, int]
    """Rows (y) and columns (x)."""


def build_occupancy(solid: Floats, visible: Floats, floor_m: float) -> tuple[GridFrame, NDArray[np.uint8]]:
    """Returns the grid of a scene: 0 free floor, 1 occupied or without floor, 2 occupied and occluding the view.

    Args:
        solid: (T, 3, 3) collider triangles, world metres.
        visible: (V, 3, 3) visible triangles including the floor, world metres.
        floor_m: height of the floor, metres.
    """
    floor = floor_triangles(visible, floor_m)
    frame = _frame_of(_in_band(solid, floor_m, BAND_M), floor)
    occupied = draw_band(solid, floor_m, BAND_M, frame)
    hiding = np.logical_and.reduce([draw_band(visible, floor_m, band, frame) for band in _HIDING_BANDS_M])
    flat = (-np.inf, np.inf)
    ground = binary_closing(np.pad(draw_band(floor, floor_m, flat, frame), 4), np.ones((5, 5)))[4:-4, 4:-4]
    grid = np.where(occupied | ~ground, OCCUPIED, FREE)
    return frame, np.where(hiding & occupied, HIDING, grid).astype(np.uint8)


def _in_band(triangles: Floats, floor_m: float, band: tuple[float, float]) -> Floats:
    heights = triangles[:, :, 2] - floor_m
    return np.asarray(triangles[(heights.max(axis=1) >= band[0]) & (heights.min(axis=1) <= band[1])])


def _frame_of(obstacles: Floats, floor: Floats) -> GridFrame:
    """Returns the grid that contains the obstacles, and the floor up to 6 m beyond them."""
    lower, upper = floor[:, :, :2].min(axis=(0, 1)), floor[:, :, :2].max(axis=(0, 1))
    if len(obstacles):
        low, high = obstacles[:, :, :2].min(axis=(0, 1)), obstacles[:, :, :2].max(axis=(0, 1))
        lower = np.minimum(low, np.maximum(lower, low - _FLOOR_BEYOND_M))
        upper = np.maximum(high, np.minimum(upper, high + _FLOOR_BEYOND_M))
    first = np.floor((lower - _PAD_M) / RESOLUTION_M) * RESOLUTION_M
    columns, rows = np.ceil((upper + _PAD_M - first) / RESOLUTION_M).astype(int)
    if rows * columns > _MAX_CELLS:
        raise WorldError(
            f"the floor spans {columns * RESOLUTION_M:.0f} x {rows * RESOLUTION_M:.0f} m, more than the grid allows "
            f"({_MAX_CELLS} cells of {RESOLUTION_M} m); check metersPerUnit or import a smaller stage"
        )
    return GridFrame((round(float(first[0]), 6), round(float(first[1]), 6)), RESOLUTION_M, (int(rows), int(columns)))


def draw_band(triangles: Floats, floor_m: float, band: tuple[float, float], frame: GridFrame) -> Bools:
    """Returns the cells (H, W) that triangles touch within a height band above the floor.

    Args:
        triangles: (T, 3, 3) world metres.
        floor_m: height of the floor, metres.
        band: lowest and highest height above the floor, metres.
        frame: origin and shape of the grid.
    """
    low, high = floor_m + band[0], floor_m + band[1]
    in_band = _in_band(triangles, floor_m, band)
    cells = np.zeros(frame.shape, bool)
    _draw_segments(cells, *_outlines(in_band, low, high), frame)
    flat = in_band[_plan_extent(in_band) > 1.5 * frame.resolution_m]
    _fill(cells, flat, low, high, frame)
    return cells


def _plan_extent(triangles: Floats) -> Floats:
    """Returns the plan width of each triangle: its altitude on its longest side in plan, metres."""
    flat = triangles[:, :, :2]
    ab, ac = flat[:, 1] - flat[:, 0], flat[:, 2] - flat[:, 0]
    area = np.abs(ab[:, 0] * ac[:, 1] - ab[:, 1] * ac[:, 0])
    longest = np.linalg.norm(flat - np.roll(flat, 1, axis=1), axis=2).max(axis=1)
    return np.asarray(area / np.maximum(longest, 1e-12))


def _outlines(triangles: Floats, low: float, high: float) -> tuple[Floats, Floats]:
    """Returns the start points (S, 2) and end points (S, 2), in plan, of the outlines of triangles clipped to a band.

    The outlines consist of the clipped sides, and of the cuts at the lower and the upper height.
    """
    starts, ends = triangles.reshape(-1, 3), np.roll(triangles, -1, axis=1).reshape(-1, 3)
    rise = ends[:, 2] - starts[:, 2]
    safe = np.where(np.abs(rise) < 1e-12, 1.0, rise)
    at_low, at_high = (low - starts[:, 2]) / safe, (high - starts[:, 2]) / safe
    is_level = np.abs(rise) < 1e-12
    enters = np.where(is_level, 0.0, np.minimum(at_low, at_high))
    leaves = np.where(is_level, 1.0, np.maximum(at_low, at_high))
    is_out = is_level & ((starts[:, 2] < low) | (starts[:, 2] > high))
    kept = ~is_out & (leaves >= 0.0) & (enters <= 1.0)
    first, last = np.clip(enters, 0.0, 1.0), np.clip(leaves, 0.0, 1.0)
    step = (ends - starts)[:, :2]
    sides = starts[:, :2] + step * first[:, None], starts[:, :2] + step * last[:, None]
    cuts = [_cut(triangles, height) for height in (low, high) if np.isfinite(height)]
    return (
        np.concatenate([sides[0][kept], *(cut[:, 0] for cut in cuts)]),
        np.concatenate([sides[1][kept], *(cut[:, 1] for cut in cuts)]),
    )


def _cut(triangles: Floats, height: float) -> Floats:
    """Returns the plan segments (C, 2, 2) in which triangles cross a height."""
    above = triangles[:, :, 2] >= height
    crossing = triangles[above.any(axis=1) & ~above.all(axis=1)]
    over = crossing[:, :, 2] >= height
    lone = np.where(over.sum(axis=1) == 1, over.argmax(axis=1), (~over).argmax(axis=1))
    rows = np.arange(len(crossing))
    tip = crossing[rows, lone]
    segments = []
    for turn in (1, 2):
        foot = crossing[rows, (lone + turn) % 3]
        share = (height - tip[:, 2]) / (foot[:, 2] - tip[:, 2])
        segments.append(tip[:, :2] + (foot - tip)[:, :2] * share[:, None])
    return np.stack(segments, axis=1)


def _draw_segments(cells: Bools, starts: Floats, ends: Floats, frame: GridFrame) -> None:
    """Marks the cells under segments, sampled at less than half a cell."""
    counts = np.ceil(np.linalg.norm(ends - starts, axis=1) / (frame.resolution_m * 0.45)).astype(np.int64) + 1
    for part in _batches(counts):
        count = counts[part]
        owner = np.repeat(np.arange(part.start, part.stop), count)
        rank = np.arange(len(owner)) - np.repeat(np.cumsum(count) - count, count)
        share = rank / np.maximum(counts[owner] - 1, 1)
        points = starts[owner] + (ends - starts)[owner] * share[:, None]
        columns, rows = np.floor((points - frame.origin_m) / frame.resolution_m).astype(np.int64).T
        inside = (rows >= 0) & (rows < frame.shape[0]) & (columns >= 0) & (columns < frame.shape[1])
        cells[rows[inside], columns[inside]] = True


def _batches(counts: NDArray[np.int64], limit: int = 4_000_000) -> list[slice]:
    """Returns slices of segments with about `limit` samples each."""
    marks = np.searchsorted(np.cumsum(counts), np.arange(limit, counts.sum() + 1, limit)) + 1
    edges = np.unique(np.concatenate([[0], np.minimum(marks, len(counts)), [len(counts)]]))
    return [slice(int(a), int(b)) for a, b in pairwise(edges)]


def _fill(cells: Bools, triangles: Floats, low: float, high: float, frame: GridFrame) -> None:
    """Marks the cells whose centre is covered by a triangle within the band; used for triangles wide in plan."""
    limits = np.array(frame.shape[::-1])
    grid = (triangles[:, :, :2] - frame.origin_m) / frame.resolution_m - 0.5
    first = np.clip(np.ceil(grid.min(axis=1)).astype(np.int64), 0, limits)
    last = np.clip(np.floor(grid.max(axis=1)).astype(np.int64) + 1, first, limits)
    span = last - first
    counts = span.prod(axis=1)
    for part in _batches(counts):
        count = counts[part]
        owner = np.repeat(np.arange(part.start, part.stop), count)
        rank = np.arange(len(owner)) - np.repeat(np.cumsum(count) - count, count)
        columns = first[owner, 0] + rank % span[owner, 0]
        rows = first[owner, 1] + rank // span[owner, 0]
        heights = _heights_at(grid[owner], triangles[owner, :, 2], np.stack([columns, rows], axis=1))
        hit = (heights >= low) & (heights <= high)
        cells[rows[hit], columns[hit]] = True


def _heights_at(plan: Floats, z: Floats, points: NDArray[np.int64]) -> Floats:
    """Returns heights (N,) of triangles at plan points by barycentric interpolation; NaN outside."""
    a, b, c = plan[:, 0], plan[:, 1], plan[:, 2]
    ab, ac, ap = b - a, c - a, points - a
    whole = ab[:, 0] * ac[:, 1] - ab[:, 1] * ac[:, 0]
    beta = (ap[:, 0] * ac[:, 1] - ap[:, 1] * ac[:, 0]) / whole
    gamma = (ab[:, 0] * ap[:, 1] - ab[:, 1] * ap[:, 0]) / whole
    inside = (beta >= 0) & (gamma >= 0) & (beta + gamma <= 1)
    heights = z[:, 0] + beta * (z[:, 1] - z[:, 0]) + gamma * (z[:, 2] - z[:, 0])
    return np.where(inside, heights, np.nan)
