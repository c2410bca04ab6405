"""Finds the meshes that enclose a whole scene, such as sky spheres, and separates them from it.

A sky is a thin convex shell: the planes of all its faces pass the rest of the scene at a distance. The walls of a
closed building do not, because its floor or its furniture reaches them. Pure functions.
"""

from __future__ import annotations

import re
from collections import defaultdict
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from factory.scenes.importer import Part
from factory.scenes.rules import split_name
from schemas.support.geometry import cross
from schemas.support.numpy_types import Bools, Floats

_SKY_WORDS = re.compile(
    r"(?:^|_)(?:sky(?:_?(?:box|dome|sphere|ball|light|map))?|env(?:ironment)?_?(?:dome|sphere|map|ball)|"
    r"(?:hdri?|panorama)_?(?:dome|sphere|ball)?|back_?ground|back_?drop|horizon)s?(?:_|$)"
)
_NAMED_GAP_M, _GAP_M = 0.3, 3.0
"""Least distance of the planes of a sky from the rest of the scene, metres: with a name that says so, and without."""
_BELOW_M = 0.5
"""Least depth of the bottom of a sky without such a name below the rest of the scene, metres, unless it is a dome."""
_DOME_RADIUS_M = 15.0
_DOME_SHARE, _SECTORS, _SECTOR_SHARE = 0.5, 8, 0.03
"""A dome has slanted faces on at least half of its area, in each of eight directions at least a share of 3 %."""
_SAME_M = 1e-3
_FLAT_M = 0.5
"""Height of a part that may be ground, which may be wider than the sky, metres."""
_GROUND_SHARE = 0.7
"""Least width of level ground in a dome, as a share of the width of the dome."""
_FLUSH_M = 0.1
_SHELL_SHARE = 0.99
_MOST_LAYERS = 8
_DIRECTIONS, _MOST_CORNERS, _MOST_PRODUCTS = 128, 100_000, 20_000_000


@dataclass(frozen=True)
class _Boxed:
    parts: Sequence[Part]
    lows: Floats
    """(P, 3) lower corners, metres."""
    highs: Floats

    @classmethod
    def of(cls, parts: Sequence[Part]) -> _Boxed:
        corners = [part.triangles.reshape(-1, 3) for part in parts]
        lows, highs = (np.array([bound(each, axis=0) for each in corners]) for bound in (np.min, np.max))
        return cls(parts, lows, highs)

    def chosen(self, rows: Bools) -> _Boxed:
        parts = [part for part, is_kept in zip(self.parts, rows, strict=True) if is_kept]
        return _Boxed(parts, self.lows[rows], self.highs[rows])


def without_surroundings(parts: Sequence[Part], notes: list[str]) -> tuple[tuple[Part, ...], bool]:
    """Returns the parts of a scene without those that enclose all others, and whether there were any.

    Args:
        parts: parts with at least one triangle each, world metres.
        notes: receives a note that names each removed prim.
    """
    boxed = _Boxed.of(parts)
    for _ in range(_MOST_LAYERS):  # spheres of sky and clouds enclose each other
        found = next(_shells(boxed), None)
        if found is None:
            break
        path, rows = found
        x, y, z = boxed.highs[rows].max(axis=0) - boxed.lows[rows].min(axis=0)
        notes.append(
            f"{path}: encloses everything else ({x:.0f} x {y:.0f} x {z:.0f} m) and is taken as sky: not drawn and no "
            "obstacle; the background of open scenes is shown instead"
        )
        boxed = boxed.chosen(~rows)
    return tuple(boxed.parts), len(boxed.parts) < len(parts)


def _shells(boxed: _Boxed) -> Iterator[tuple[str, Bools]]:
    """Yields the outermost prims that enclose all others: path, and which parts (P,) belong to the prim."""
    for path, rows in _outermost(boxed):
        if rows.all() or all(part.is_collider for part in boxed.chosen(~rows).parts):
            continue
        shell, rest = _Shell.of(boxed.chosen(rows), path), boxed.chosen(~rows)
        inside = rest.chosen(~_is_ground(rest, shell))
        if inside.parts and _encloses(shell, inside):
            yield path, rows


def _outermost(boxed: _Boxed) -> Iterator[tuple[str, Bools]]:
    """Yields the prims and parts that reach the limits of the scene on all sides and at the top, the widest first."""
    is_high = (boxed.highs - boxed.lows)[:, 2] > _FLAT_M
    if np.count_nonzero(is_high) < 2:
        return
    named = _named(boxed.parts)
    low, high = boxed.lows[is_high].min(axis=0), boxed.highs[is_high].max(axis=0)
    reached = np.column_stack((boxed.lows[:, :2] <= low[:2] + _SAME_M, boxed.highs >= high - _SAME_M))
    reached[~is_high & ~named] = False
    sides: dict[str, Bools] = defaultdict(lambda: np.zeros(5, bool))
    for row in np.flatnonzero(reached.any(axis=1)).tolist():
        steps = boxed.parts[row].path.split("/")
        for count in range(2, len(steps) + 1):
            sides["/".join(steps[:count])] |= reached[row]
    paths = np.array([part.path for part in boxed.parts])
    for path in sorted((path for path, met in sides.items() if met.all()), key=lambda path: (path.count("/"), path)):
        rows = (paths == path) | np.char.startswith(paths, f"{path}/")
        yield path, rows
        if len(set(paths[rows])) == 1:  # a prim with several materials
            yield from ((path, _row(len(paths), row)) for row in np.flatnonzero(rows & reached.all(axis=1)).tolist())
    if named.any():  # the sides of a box may be separate prims
        yield str(paths[named][0]).rpartition("/")[0] or "/", named


def _row(count: int, row: int) -> Bools:
    return np.asarray(np.arange(count) == row)


def _named(parts: Sequence[Part]) -> Bools:
    return np.array([_is_named(part.path, [part]) for part in parts], bool)


def _is_named(path: str, parts: Sequence[Part]) -> bool:
    names = {*path.split("/")[-2:], *(part.surface.name for part in parts)}
    return any(_SKY_WORDS.search(split_name(name)) for name in names)


@dataclass(frozen=True)
class _Shell:
    """Faces of the parts that may be a sky."""

    low: Floats
    high: Floats
    triangles: Floats
    normals: Floats
    areas: Floats
    is_named: bool

    @classmethod
    def of(cls, boxed: _Boxed, path: str) -> _Shell:
        triangles = np.concatenate([part.triangles for part in boxed.parts])
        normals = cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
        doubled = np.linalg.norm(normals, axis=1)
        kept = doubled > 0
        normals = normals[kept] / doubled[kept, None]
        is_named = bool(_named(boxed.parts).all()) or _is_named(path, boxed.parts)
        low, high = boxed.lows.min(axis=0), boxed.highs.max(axis=0)
        return cls(low, high, triangles=triangles[kept], normals=normals, areas=doubled[kept] / 2, is_named=is_named)

    @property
    def is_dome(self) -> bool:
        """Whether the faces are slanted in all directions, as those of a large sphere or of a part of it."""
        rise = np.abs(self.normals[:, 2])
        slanted = np.where((rise > 0.1) & (rise < 0.98), self.areas, 0.0)
        turn = np.arctan2(self.normals[:, 1], self.normals[:, 0]) % np.pi  # both windings of a face are one direction
        sector = np.minimum((turn / np.pi * _SECTORS).astype(np.int64), _SECTORS - 1)
        standing = self.areas[rise < 0.98].sum()
        shares = np.bincount(sector, weights=slanted, minlength=_SECTORS) / max(standing, 1e-12)
        is_large = (self.high - self.low)[:2].min() >= 2 * _DOME_RADIUS_M
        return bool(is_large and shares.sum() >= _DOME_SHARE and shares.min() >= _SECTOR_SHARE)

    def distances(self, points: Floats) -> Floats:
        """Returns the distance (T,) of the plane of each face from points (N, 3); negative if it divides them."""
        offsets = np.einsum("tk,tk->t", self.normals, self.triangles[:, 0])
        lowest, highest = np.full(len(offsets), np.inf), np.full(len(offsets), -np.inf)
        for some in np.array_split(points, max(1, len(points) * len(offsets) // _MOST_PRODUCTS)):
            heights = some @ self.normals.T - offsets
            lowest, highest = np.minimum(lowest, heights.min(axis=0)), np.maximum(highest, heights.max(axis=0))
        return np.asarray(np.maximum(lowest, -highest))


def _is_ground(rest: _Boxed, shell: _Shell) -> Bools:
    """Returns which parts are level ground that extends beyond a shell, or almost to the sides of a dome."""
    size = rest.highs - rest.lows
    beyond = (rest.lows < shell.low - _SAME_M)[:, :2].any(axis=1)
    beyond |= (rest.highs > shell.high + _SAME_M)[:, :2].any(axis=1)
    if shell.is_dome:
        beyond |= (size[:, :2] >= _GROUND_SHARE * (shell.high - shell.low)[:2]).all(axis=1)
    return np.asarray(beyond & (size[:, 2] <= _FLAT_M))


def _encloses(shell: _Shell, rest: _Boxed) -> bool:
    """Returns whether a shell is convex around the rest of a scene, with enough distance."""
    low = rest.lows.min(axis=0)
    gap = _NAMED_GAP_M if shell.is_named else _GAP_M
    is_bottom = (np.abs(shell.normals[:, 2]) > 0.98) & (shell.triangles[:, :, 2].max(axis=1) < low[2] + _FLUSH_M)
    for points in ((rest.lows + rest.highs) / 2, _extremes(rest)):  # the centres refute most prims
        is_apart = (shell.distances(points) >= gap) | is_bottom
        if shell.areas[is_apart].sum() < _SHELL_SHARE * shell.areas.sum():
            return False
    return shell.is_named or bool(shell.low[2] <= low[2] - _BELOW_M) or shell.is_dome


def _extremes(boxed: _Boxed) -> Floats:
    """Returns the outermost corners (D, 3) of parts along many directions."""
    number = np.arange(_DIRECTIONS) + 0.5
    z, turn = 1 - 2 * number / _DIRECTIONS, np.pi * (3 - np.sqrt(5)) * number
    flat = np.sqrt(1 - z * z)
    ways = np.column_stack((flat * np.cos(turn), flat * np.sin(turn), z))
    best, points = np.full(_DIRECTIONS, -np.inf), np.zeros((_DIRECTIONS, 3))
    for part in boxed.parts:
        for corners in np.array_split(part.triangles.reshape(-1, 3), 1 + 3 * len(part.triangles) // _MOST_CORNERS):
            reach = corners @ ways.T
            farthest = reach.argmax(axis=0)
            values = reach[farthest, np.arange(_DIRECTIONS)]
            better = values > best
            best[better], points[better] = values[better], corners[farthest[better]]
    return points
