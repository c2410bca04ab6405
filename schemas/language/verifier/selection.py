"""Selects one of several objects by a superlative or an ordinal, for the verifier. Measures nothing."""

from __future__ import annotations

from collections.abc import Mapping
from enum import IntEnum
from itertools import combinations, pairwise

from schemas.language import thresholds as limit
from schemas.language.expression import AHEAD_SIDES, Size, ViewSide
from schemas.language.graph.view import SceneView
from schemas.language.verifier.measure import AlongBox, Footprints, Truth, at_least, at_most


class Selected(IntEnum):
    """Value that a superlative selects."""

    LEAST = -1  # the smallest value
    MOST = 1  # the largest value


def by_size(truths: dict[int, Truth], size: Size, prints: Footprints) -> dict[int, Truth]:
    """Returns the largest, smallest, tallest or lowest object if it is clear; otherwise all candidates, as `MAYBE`."""
    tall = size in (Size.TALLEST, Size.LOWEST)
    if not all(prints.is_comparable(number) for number in truths):
        return dict.fromkeys(truths, Truth.MAYBE)
    values = {number: prints.height(number) if tall else prints.volume(number) for number in truths}
    way = Selected.MOST if size in (Size.TALLEST, Size.LARGEST) else Selected.LEAST
    if tall and not all(prints.has_same_base(one, two) for one, two in combinations(truths, 2)):
        return dict.fromkeys(truths, Truth.MAYBE)
    return extreme(truths, values, way=way, ratio=limit.HEIGHT_RATIO if tall else limit.VOLUME_RATIO, gap=0.0)


def counted(truths: dict[int, Truth], place: int, side: ViewSide, view: SceneView) -> dict[int, Truth]:
    """Returns the object in view at a position counted from a side; if it is uncertain, all candidates as `MAYBE`."""
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


def counted_ahead(
    truths: Mapping[int, Truth], place: int, side: ViewSide, view: SceneView, prints: Footprints
) -> dict[int, Truth]:
    """Returns the object at a position on one side of the way ahead; if it is uncertain, all candidates as `MAYBE`."""
    # for equal racks in rows, no other phrase fits only one of them
    boxes = {number: prints.seen_along((view.x, view.y), view.yaw, number, AHEAD_SIDES[side]) for number in truths}
    ahead = {number: min(truth, _is_in_row(boxes[number])) for number, truth in truths.items()}
    sure = [boxes[number] for number, truth in ahead.items() if truth is Truth.YES]
    row = {
        number: truth
        for number, truth in ahead.items()
        if truth is not Truth.NO and (view.shown[number] or not any(_covers(other, boxes[number]) for other in sure))
    }
    order = sorted(row, key=lambda number: boxes[number].middle)
    if len(order) < place:
        return {}
    steps = [abs(boxes[a].middle - boxes[b].middle) for a, b in pairwise(order[: place + 1])]
    is_sure = all(row[number] is Truth.YES and view.shown[number] for number in order[:place])
    if is_sure and all(step >= limit.ROW_STEP_M for step in steps):
        return {order[place - 1]: Truth.YES}
    return dict.fromkeys(order, Truth.MAYBE)


def _is_in_row(box: AlongBox) -> Truth:
    """Returns whether an object is ahead of the start and beside the way."""
    aside = Truth.YES if box.near >= limit.ROW_ASIDE_M.good else Truth.MAYBE if box.far > limit.ROW_ASIDE_M.bad else 0
    return min(at_least(box.middle, limit.ROW_AHEAD_M), Truth(aside), at_most(box.near, limit.ROW_GAP_M))


def _covers(cover: AlongBox, box: AlongBox) -> bool:
    """Returns whether an object hides at least half of the length of another one, as seen from the way."""
    shared = min(cover.high, box.high) - max(cover.low, box.low)
    return box.near >= cover.near + limit.ROW_HIDDEN_M and shared >= limit.ROW_HIDDEN * (box.high - box.low)


def extreme(
    truths: Mapping[int, Truth],
    values: Mapping[int, float],
    way: Selected,
    ratio: float = limit.DISTANCE_RATIO,
    gap: float = limit.DISTANCE_GAP_M,
) -> dict[int, Truth]:
    """Returns the object with the smallest or largest value, if the difference is clear; otherwise all, as `MAYBE`."""
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
