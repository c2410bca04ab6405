"""Selects the targets of a scene from the candidates: reachable objects with stable names, colours and tiers.

Pure. Adds a note for every candidate that is left out.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from factory.scenes.compile.shade import target_colour
from factory.scenes.compile.textures import TextureBook
from factory.scenes.importer import Part
from factory.scenes.navigation.reach import SEE_RANGE_M, Terrain, is_reachable, ring_tiers
from factory.scenes.targets.candidates import Candidate
from schemas.scene import Target
from schemas.terms import Tier

__all__ = ["HIGHEST_BOTTOM_M", "list_targets", "with_colours", "with_far_tier"]

HIGHEST_BOTTOM_M = 2.0
"""Maximum height of the bottom of a target above the floor, metres."""


def list_targets(
    terrain: Terrain, candidates: Sequence[Candidate], ids: Mapping[str, int], floor_m: float, notes: list[str]
) -> tuple[Target, ...]:
    """Returns the reachable candidates as targets without colours, in the order of their paths.

    Names number all candidates of a category, so that a target keeps its name when another becomes reachable.
    """
    seen: Counter[str] = Counter()
    targets = []
    for candidate in candidates:
        seen[candidate.category] += 1
        target = _target(candidate, f"{candidate.category}_{seen[candidate.category]:03d}", ids[candidate.path])
        bottom = float(candidate.box[0, 2]) - floor_m
        if not -1.0 < bottom < HIGHEST_BOTTOM_M:
            notes.append(f"{target.target_id}: left out, it hangs {bottom:.2f} m over the floor ({candidate.path})")
        elif not is_reachable(terrain, target):
            notes.append(f"{target.target_id}: left out, no pose within its success circle fits ({candidate.path})")
        else:
            straight, connected = ring_tiers(terrain, target)
            targets.append(target.model_copy(update={"straight_tiers": straight, "connected_tiers": connected}))
    return tuple(targets)


def _target(candidate: Candidate, name: str, instance_id: int) -> Target:
    centre, size = candidate.box.mean(axis=0), np.ptp(candidate.box, axis=0)
    return Target(
        target_id=name,
        category=candidate.category,
        instance_id=instance_id,
        prim_path=candidate.path,
        centroid_m=_rounded(centre),
        size_m=_rounded(size),
    )


def _rounded(vector: NDArray[np.float64]) -> tuple[float, float, float]:
    """Rounds to tenths of a millimetre, so that the result does not depend on the machine."""
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


def with_far_tier(
    targets: Sequence[Target], spawns: NDArray[np.float64], sees: NDArray[np.uint8]
) -> tuple[Target, ...]:
    """Returns the targets with the far tier: straight if a spawn sees the target, connected if a spawn is far away."""
    full = []
    for column, target in enumerate(targets):
        distance = np.linalg.norm(spawns - np.asarray(target.centroid_m[:2]), axis=1)
        straight = target.straight_tiers + ((Tier.FAR,) if sees[:, column].any() else ())
        connected = target.connected_tiers + ((Tier.FAR,) if (distance >= SEE_RANGE_M[0]).any() else ())
        full.append(target.model_copy(update={"straight_tiers": straight, "connected_tiers": connected}))
    return tuple(full)
