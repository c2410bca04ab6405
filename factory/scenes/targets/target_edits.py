"""Applies the user's edited target list: cuts out boxes, selects the target prims, sets ids, categories and colours.

Pure functions. Prims that are not listed stay in the scene as objects.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from factory.scenes.importer import Part
from factory.scenes.targets.candidates import Candidate
from factory.scenes.targets.target_list import TargetEntry, TargetList
from schemas.errors import UsageError
from schemas.scene import Target
from schemas.support.numpy_types import Bools, Floats, Ints


def cut_boxes(parts: Sequence[Part], chosen: TargetList | None) -> tuple[Part, ...]:
    """Returns the parts with the triangles in the boxes of a target list as separate parts below `/Boxes`.

    A triangle belongs to the box that contains its centroid; the level faces at the bottom of a box remain, because
    they are the floor.

    Args:
        parts: parts of the scene.
        chosen: target list of the user, or `None`.

    Raises:
        UsageError: a box contains no visible triangle, or the same triangles as another one.
    """
    rows = [] if chosen is None else [entry for entry in chosen.targets if entry.box_m is not None]
    if not rows:
        return tuple(parts)
    visible = [part for part in parts if not part.is_collider]
    middles = [part.triangles.mean(axis=1) for part in visible]
    owners = [np.full(len(part.triangles), -1) for part in visible]
    for number, entry in enumerate(rows):
        inside = [_in_box(part.triangles, middle, entry) for part, middle in zip(visible, middles, strict=True)]
        count = sum(int(rows_inside.sum()) for rows_inside in inside)
        if not count:
            raise UsageError(f"targets file: {entry.id}: {_box_text(entry)} contains nothing; {extent_of(visible)}")
        for owner, rows_inside in zip(owners, inside, strict=True):
            others = np.unique(owner[rows_inside & (owner >= 0)])
            if len(others):
                raise UsageError(
                    f"targets file: the boxes of {rows[int(others[0])].id} and {entry.id} contain the same faces; make "
                    "one of them smaller"
                )
            owner[rows_inside] = number
    cut = [piece for part, owner in zip(visible, owners, strict=True) for piece in _divided(part, owner, rows)]
    return tuple(sorted([*cut, *(part for part in parts if part.is_collider)], key=lambda part: part.path))


_FLOOR_SKIN_M = 0.03


def _in_box(triangles: Floats, middles: Floats, entry: TargetEntry) -> Bools:
    low, high = np.array(entry.box_m)
    inside = ((middles >= low) & (middles <= high)).all(axis=1)
    rise = np.ptp(triangles[:, :, 2], axis=1)
    is_floor = (rise < _FLOOR_SKIN_M) & (middles[:, 2] < low[2] + _FLOOR_SKIN_M)
    return np.asarray(inside & ~is_floor)


def _divided(part: Part, owner: Ints, rows: Sequence[TargetEntry]) -> Iterator[Part]:
    """Yields the triangles of a part for each owner: a row, or -1 for the part itself."""
    for number in np.unique(owner).tolist():
        mine = owner == number
        yield replace(
            part,
            path=part.path if number < 0 else rows[number].prim_path,
            triangles=part.triangles[mine],
            uvs=None if part.uvs is None else part.uvs[mine],
            tints=None if part.tints is None else part.tints[mine],
        )


def _box_text(entry: TargetEntry) -> str:
    low, high = ([f"{value:g}" for value in corner] for corner in entry.box_m or ())
    return f"the box from ({', '.join(low)}) to ({', '.join(high)}) m"


def extent_of(parts: Sequence[Part]) -> str:
    """Returns a text on the corners of the box around parts, which are those of the map, too."""
    low, high = ([f"{value:.2f}" for value in corner] for corner in _box(parts))
    return f"the scene extends from ({', '.join(low)}) to ({', '.join(high)}) m, z up"


def apply_candidate_edits(
    candidates: tuple[Candidate, ...], parts: Sequence[Part], chosen: TargetList | None
) -> tuple[Candidate, ...]:
    """Returns the listed prims as candidates, with the candidates of the rules that do not overlap them.

    Args:
        candidates: candidates that the rules find.
        parts: visible parts.
        chosen: target list of the user, or `None` to return `candidates`.

    Raises:
        UsageError: the list names prims that are not visible, or a prim inside another listed prim.
    """
    if chosen is None:
        return candidates
    paths = [entry.prim_path for entry in chosen.targets]
    inner = [(a, b) for a in paths for b in paths if a.startswith(b + "/")]
    if inner:
        raise UsageError(f"targets file: prim {inner[0][0]} is inside prim {inner[0][1]}; list only one of them")
    groups = [[part for part in parts if _is_in(part.path, path)] for path in paths]
    unknown = [path for path, group in zip(paths, groups, strict=True) if not group]
    if unknown:
        raise UsageError(
            f"targets file: the scene has no visible prim {', '.join(unknown)}; `factory scene targets` lists its prims"
        )
    listed = [
        Candidate(entry.prim_path, entry.category, _box(group))
        for entry, group in zip(chosen.targets, groups, strict=True)
    ]
    apart = [one for one in candidates if not any(_is_in(one.path, path) or _is_in(path, one.path) for path in paths)]
    return tuple(sorted([*listed, *apart], key=lambda candidate: candidate.path))


def _is_in(path: str, ancestor: str) -> bool:
    return path == ancestor or path.startswith(ancestor + "/")


def _box(parts: Sequence[Part]) -> np.ndarray[tuple[int, ...], np.dtype[np.float64]]:
    corners = np.concatenate([part.triangles.reshape(-1, 3) for part in parts])
    return np.stack([corners.min(axis=0), corners.max(axis=0)])


def apply_target_edits(targets: tuple[Target, ...], chosen: TargetList | None) -> tuple[Target, ...]:
    """Returns the enabled targets with the ids of the list."""
    if chosen is None:
        return targets
    # the list is complete, not a list of changes: a target whose line the user deleted is removed
    names = {entry.prim_path: entry.id for entry in chosen.targets if entry.enabled}
    return tuple(
        target.model_copy(update={"target_id": names[target.prim_path]})
        for target in targets
        if target.prim_path in names
    )


def recoloured(targets: tuple[Target, ...], chosen: TargetList | None) -> tuple[Target, ...]:
    colours = {} if chosen is None else {entry.prim_path: entry.colour for entry in chosen.targets}
    return tuple(
        target.model_copy(update={"colour": colours.get(target.prim_path, target.colour)}) for target in targets
    )
