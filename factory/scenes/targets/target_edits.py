"""Applies the user's edited target list: selects the target prims and sets their ids, categories and colours.

Pure functions. Prims that are not listed stay in the scene as objects.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from factory.scenes.importer import Part
from factory.scenes.targets.candidates import Candidate
from factory.scenes.targets.target_list import TargetList
from schemas.errors import UsageError
from schemas.scene import Target


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
