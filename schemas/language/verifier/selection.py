"""Selects one of several objects by a superlative or an ordinal, for the verifier. Measures nothing."""

from __future__ import annotations

from collections.abc import Mapping
from enum import IntEnum
from itertools import combinations, pairwise

from schemas.language import thresholds as limit
from schemas.language.expression import Size, ViewSide
from schemas.language.verifier.measure import Footprints, Truth
from schemas.language.view import SceneView


class Selected(IntEnum):
    """Kinds of measures by which a superlative selects."""

    LEAST = -1  # the smallest value
    MOST = 1  # the largest value


def by_size(truths: dict[int, Truth], size: Size, prints: Footprints) -> dict[int, Truth]:
    """Returns the largest, smallest, tallest or lowest object if it is clear; otherwise all objects that may be it."""
    tall = size in (Size.TALLEST, Size.LOWEST)
    values = {number: prints.height(number) if tall else prints.volume(number) for number in truths}
    way = Selected.MOST if size in (Size.TALLEST, Size.LARGEST) else Selected.LEAST
    if tall and not all(prints.has_same_base(one, two) for one, two in combinations(truths, 2)):
        return dict.fromkeys(truths, Truth.MAYBE)
    return extreme(truths, values, way, limit.HEIGHT_RATIO if tall else limit.VOLUME_RATIO, 0.0)


def counted(truths: dict[int, Truth], place: int, side: ViewSide, view: SceneView) -> dict[int, Truth]:
    """Returns the object at a place from a side among those in view; all that it may be if some are borderline."""
    sign = -1.0 if side is ViewSide.LEFT else 1.0
    seen = [number for number in truths if view.possible[number]]
    order = sorted(seen, key=lambda number: sign * float(view.bearing[number]))
    counted = order[: place + 1]
    if len(order) < place:
        return {}
    angles = [float(view.bearing[number]) for number in counted]
    is_apart = all(abs(one - two) >= limit.BEARING_GAP_RAD for one, two in pairwise(angles))
    is_sure = all(truths[number] is Truth.YES and view.sure[number] for number in order[:place])
    several = sum(truths[number] is Truth.YES and bool(view.sure[number]) for number in order) > 1
    if is_apart and is_sure and several:
        return {order[place - 1]: Truth.YES}
    return dict.fromkeys(order, Truth.MAYBE)


def extreme(
    truths: Mapping[int, Truth],
    values: Mapping[int, float],
    way: Selected,
    ratio: float = limit.DISTANCE_RATIO,
    gap: float = limit.DISTANCE_GAP_M,
) -> dict[int, Truth]:
    """Returns the object with the extreme value if it is clear; otherwise all objects that may have it."""
    best = max(truths, key=lambda number: way * values[number], default=None)
    if best is None:
        return {}
    rest = [values[number] for number in truths if number != best]
    if way is Selected.LEAST:
        is_clear = all(value >= max(values[best] * ratio, values[best] + gap) for value in rest)
    else:
        is_clear = all(values[best] >= max(value * ratio, value + gap) for value in rest)
    if is_clear and truths[best] is Truth.YES:
        return {best: Truth.YES}
    return dict.fromkeys(truths, Truth.MAYBE)
