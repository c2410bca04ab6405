"""Finds the objects of a compiled scene that words can name, or that a viewer may take for such an object.

Measures only their boxes; `scene_graph` computes rooms and walls.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from schemas.language.kinds import UNKNOWN, UNNAMED, Kinds
from schemas.scene import CompiledScene, Instance
from schemas.support.numpy_types import Floats


@dataclass(frozen=True)
class RawObject:
    """Object whose room and distances to walls are not computed yet."""

    ids: tuple[int, ...]
    """Instance ids of its parts."""
    kind: str
    """Category, special kind of a category, or kind of a landmark."""
    low: Floats
    """(3,) lower corner of its bounding box, metres."""
    high: Floats
    """(3,) upper corner, metres."""
    outline: Floats
    """(K, 2) vertices of its footprint, counter-clockwise, metres."""
    colour: str = UNKNOWN
    """Dominant colour, or `unknown`."""
    target_id: str | None = None
    """Target id of the object; `None` if it is not a target."""
    looks: str | None = None
    """Kind that its prim names, if it differs from `kind` and a viewer may see the object as that kind."""
    shows: tuple[str, ...] = ()
    """Kinds for which a viewer may mistake it or a part of it."""
    materials: tuple[str, ...] = ()
    """Recorded materials."""


def find_objects(scene: CompiledScene, table: Kinds) -> list[RawObject]:
    """Returns the objects that have a category, or whose prim name contains the name of a kind or of a similar thing.

    Args:
        scene: compiled scene.
        table: known kinds.
    """
    boxes = _boxes(scene)
    targets = {target.instance_id: target for target in scene.info.targets}
    parts: dict[tuple[str, tuple[str, ...], str], list[int]] = defaultdict(list)
    objects = []
    for instance in scene.info.instances:
        target = targets.get(instance.id)
        if target is not None:
            centre, half = np.array(target.centroid_m), np.array(target.size_m) / 2
            low, high = centre - half, centre + half
            outline = np.array(target.footprint_m) if target.footprint_m else _rectangle(low, high)
            objects.append(
                _of_category(
                    table,
                    instance,
                    category=target.category,
                    low=low,
                    high=high,
                    outline=outline,
                    colour=target.colour,
                    target_id=target.target_id,
                )
            )
        elif instance.id not in boxes:
            continue
        elif instance.category is not None:
            low, high = boxes[instance.id]
            objects.append(
                _of_category(
                    table, instance, category=instance.category, low=low, high=high, outline=_rectangle(low, high)
                )
            )
        else:
            key = _landmark_key(table, instance.prim_path.split("/"))
            if key is not None:
                parts[key].append(instance.id)
    for (kind, shows, _), ids in parts.items():
        low = np.min([boxes[number][0] for number in ids], axis=0)
        high = np.max([boxes[number][1] for number in ids], axis=0)
        objects.append(RawObject(tuple(ids), kind, low=low, high=high, outline=_rectangle(low, high), shows=shows))
    return objects


def _of_category(
    table: Kinds,
    instance: Instance,
    category: str,
    low: Floats,
    high: Floats,
    outline: Floats,
    colour: str = UNKNOWN,
    target_id: str | None = None,
) -> RawObject:
    segments = instance.prim_path.split("/")
    named, seen, kind = table.landmark_of(segments), table.seen_in(segments), table.special_of(category, segments)
    is_alike = named is not None and named[0] != kind and named[0] in table.borderline_of(category)
    return RawObject(
        ids=(instance.id,),
        kind=kind,
        low=low,
        high=high,
        outline=outline,
        colour=colour,
        target_id=target_id,
        looks=named[0] if named is not None and is_alike else None,
        shows=() if seen is None else tuple(each for each in seen[0] if each not in (kind, category)),
        materials=instance.materials,
    )


def _landmark_key(table: Kinds, segments: Sequence[str]) -> tuple[str, tuple[str, ...], str] | None:
    """Returns the kind of the object that contains a prim without a category, the kinds for which a viewer may
    mistake the object, and its path; `None` if no segment of the prim's path names a kind."""
    named, seen = table.landmark_of(segments), table.seen_in(segments)
    if named is not None:
        return named[0], (), "/".join(segments[: named[1] + 1])
    return None if seen is None else (UNNAMED, seen[0], "/".join(segments[: seen[1] + 1]))


def _boxes(scene: CompiledScene) -> dict[int, tuple[Floats, Floats]]:
    """Returns the bounding box of each instance that has triangles."""
    if not len(scene.part_first):
        return {}
    order = np.argsort(scene.part_first)
    first = scene.part_first[order]
    lows: NDArray[np.float32] = np.minimum.reduceat(scene.positions, first, axis=0)
    highs: NDArray[np.float32] = np.maximum.reduceat(scene.positions, first, axis=0)
    boxes: dict[int, tuple[Floats, Floats]] = {}
    for number, low, high in zip(scene.part_instance[order].tolist(), lows, highs, strict=True):
        if number in boxes:
            low, high = np.minimum(boxes[number][0], low), np.maximum(boxes[number][1], high)
        boxes[number] = (low.astype(float), high.astype(float))
    return boxes


def _rectangle(low: Floats, high: Floats) -> Floats:
    return np.array([(low[0], low[1]), (high[0], low[1]), (high[0], high[1]), (low[0], high[1])])
