"""Assigns each part to an object (target, model or single prim) and numbers the objects by path.

Pure; works on paths only. Does not use geometry or categories.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence

from factory.scenes.importer import Part
from schemas.errors import WorldError

MAX_INSTANCES = 65535


def assign_objects(parts: Sequence[Part], things: Iterable[str], models: Iterable[str]) -> tuple[str, ...]:
    """Returns the path of the object that each part belongs to.

    Args:
        parts: visible parts.
        things: paths of target candidates; they take precedence.
        models: paths of instances and components; the outermost applies.
    """
    first, second = frozenset(things), frozenset(models)
    owners = [_owner(part.path, first) or _owner(part.path, second) or part.path for part in parts]
    depth = max((path.count("/") for path in owners), default=0)
    while len(set(owners)) > MAX_INSTANCES:
        depth -= 1
        if depth < 1:
            raise WorldError(
                f"the scene has more than {MAX_INSTANCES} instances, the limit of the 16-bit id image; split the scene"
            )
        owners = [path if path in first else "/".join(path.split("/")[: depth + 1]) for path in owners]
    return tuple(owners)


def _owner(path: str, known: frozenset[str]) -> str:
    """Returns the outermost known ancestor of a path, else the path itself if it is known, else an empty string."""
    steps = path.split("/")
    prefixes = ("/".join(steps[:count]) for count in range(2, len(steps) + 1))
    return next((prefix for prefix in prefixes if prefix in known), "")


def number_objects(owners: Iterable[str]) -> dict[str, int]:
    """Returns the instance ids 1, 2, ... of the objects in the order of their paths."""
    return {path: number for number, path in enumerate(sorted(set(owners)), 1)}
