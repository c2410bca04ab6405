"""Selects the targets of a scene from the candidates: reachable objects with stable names, colours and tiers.

Pure functions. Adds a note for every candidate that is omitted.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from factory.scenes.compile.shade import target_colour
from factory.scenes.compile.textures import TextureBook
from factory.scenes.importer import Part
from factory.scenes.navigation.reach import Terrain, tiers_of
from factory.scenes.targets.candidates import Candidate
from factory.scenes.targets.footprint import footprint_of
from schemas.scene import Target
from schemas.support.numpy_types import Floats
from schemas.terms import SuccessMeasure, Tier

TiersOfPaths = tuple[tuple[Tier, ...], tuple[Tier, ...]]
"""Tiers from which a target is reachable by straight driving, and by any path."""
HIGHEST_BOTTOM_M = 2.0
"""Maximum height of the bottom of a target above the floor, metres."""


def list_targets(
    terrain: Terrain,
    candidates: Sequence[Candidate],
    shapes: Mapping[str, Floats],
    ids: Mapping[str, int],
    spawns: Floats,
    floor_m: float,
    notes: list[str],
) -> tuple[Target, ...]:
    """Returns the candidates that are reachable by any success measure, as targets without colours, in path order.

    The numbers in the names count all candidates of a category, reachable or not, so a target keeps its name when
    another candidate becomes reachable.

    Args:
        terrain: floor of the scene.
        candidates: candidates in the order of their paths.
        shapes: triangles (T, 3, 3) of each candidate by its path, world metres.
        ids: instance ids by path.
        spawns: (S, 2) surveyed points, metres.
        floor_m: height of the floor, metres.
        notes: receives a note for each candidate that is omitted.
    """
    named = _named_targets(candidates, ids, shapes)
    tiers = {success: tiers_of(terrain, [one for one, _ in named], success, spawns) for success in SuccessMeasure}
    by_centroid, by_surface = tiers[SuccessMeasure.CENTROID], tiers[SuccessMeasure.SURFACE]
    targets = []
    for (target, bottom_m), centroid, surface in zip(named, by_centroid, by_surface, strict=True):
        bottom = bottom_m - floor_m
        if not -1.0 < bottom < HIGHEST_BOTTOM_M:
            notes.append(f"{target.target_id}: omitted, it hangs {bottom:.2f} m over the floor ({target.prim_path})")
        elif not (centroid or surface):
            notes.append(f"{target.target_id}: omitted, no pose within its success region fits ({target.prim_path})")
        else:
            targets.append(_with_tiers(target, centroid or ((), ()), surface or ((), ())))
    return tuple(targets)


def _named_targets(
    candidates: Sequence[Candidate], ids: Mapping[str, int], shapes: Mapping[str, Floats]
) -> list[tuple[Target, float]]:
    """Returns the candidates as targets, each with the height of its bottom, metres."""
    seen: Counter[str] = Counter()
    named = []
    for candidate in candidates:
        seen[candidate.category] += 1
        name = f"{candidate.category}_{seen[candidate.category]:03d}"
        target = _target(candidate, name, ids[candidate.path], shapes[candidate.path])
        named.append((target, float(candidate.box[0, 2])))
    return named


def _with_tiers(target: Target, centroid: TiersOfPaths, surface: TiersOfPaths) -> Target:
    found = {
        "straight_tiers": centroid[0],
        "connected_tiers": centroid[1],
        "surface_straight_tiers": surface[0],
        "surface_connected_tiers": surface[1],
    }
    return target.model_copy(update=found)


def _target(candidate: Candidate, name: str, instance_id: int, shape: Floats) -> Target:
    centre, size = candidate.box.mean(axis=0), np.ptp(candidate.box, axis=0)
    return Target(
        target_id=name,
        category=candidate.category,
        instance_id=instance_id,
        prim_path=candidate.path,
        centroid_m=_rounded(centre),
        size_m=_rounded(size),
        footprint_m=footprint_of(shape),
    )


def _rounded(vector: NDArray[np.float64]) -> tuple[float, float, float]:
    """Rounds to tenths of a millimetre, so the result does not depend on the machine."""
    x, y, z = (round(float(value), 4) for value in vector)
    return (x, y, z)


def with_colours(
    targets: Sequence[Target],
    parts: Sequence[Part],
    owners: Sequence[str],
    book: TextureBook,
    uncoloured: frozenset[str] = frozenset(),
) -> tuple[Target, ...]:
    """Returns the targets with the names of their dominant colours, except for uncoloured categories."""
    own: dict[str, list[Part]] = {}
    for part, owner in zip(parts, owners, strict=True):
        own.setdefault(owner, []).append(part)
    named = []
    for target in targets:
        if target.category in uncoloured:
            named.append(target)
            continue
        named.append(target.model_copy(update={"colour": target_colour(own[target.prim_path], book)}))
    return tuple(named)
