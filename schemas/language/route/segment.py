"""Divides a driven path into turns and straight runs by the heading. Names no objects."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from schemas.language.route.meaning import DrivenPath, TurnSize
from schemas.language.route.thresholds import RUN_M, STRAIGHT_RAD, TURN_RAD
from schemas.support.numpy_types import Floats, Ints

_EVERY = 3
"""Interval between two samples of the path, frames."""
_SETTLED_RAD = 0.09
"""Deviation from the heading of a straight run at which a turn begins and ends."""


class PathPart(NamedTuple):
    """Turn or straight run of a path, as a span of frames."""

    start: int
    """First frame."""
    end: int
    """Frame after the last one."""
    turn_rad: float
    """Change of heading, positive to the left; 0 for a straight run."""


def divide_path(path: DrivenPath) -> list[PathPart]:
    """Returns the turns and straight runs of a path, in order; together they cover all frames."""
    last = len(path) - 1
    places = np.unique(np.append(np.arange(0, last, _EVERY), last))
    runs = sorted(_runs(path.yaw[places], path.along[places], 0, len(places)))
    spans = [(int(places[first]), int(places[stop - 1])) for first, stop in runs]
    return _joined(path, spans)


def _runs(yaw: Floats, along: Floats, first: int, stop: int) -> Iterator[tuple[int, int]]:
    """Yields the straight runs within the samples from `first` to `stop`, the longest run first."""
    if stop - first < 2 or along[stop - 1] - along[first] < RUN_M:
        return
    begin, end = _longest(yaw, along, first, stop)
    if along[end - 1] - along[begin] < RUN_M:
        return
    yield begin, end
    yield from _runs(yaw, along, first, begin)
    yield from _runs(yaw, along, end, stop)


def _longest(yaw: Floats, along: Floats, first: int, stop: int) -> tuple[int, int]:
    """Returns the samples of the longest stretch whose headings differ by at most `STRAIGHT_RAD`."""
    lows: deque[int] = deque()
    highs: deque[int] = deque()
    best, begin = (first, first + 1), first
    for end in range(first, stop):
        for kept, sign in ((lows, 1.0), (highs, -1.0)):
            while kept and sign * yaw[kept[-1]] >= sign * yaw[end]:
                kept.pop()
            kept.append(end)
        while yaw[highs[0]] - yaw[lows[0]] > STRAIGHT_RAD:
            begin = min(lows[0], highs[0]) + 1
            for kept in (lows, highs):
                while kept[0] < begin:
                    kept.popleft()
        if along[end] - along[begin] > along[best[1] - 1] - along[best[0]]:
            best = (begin, end + 1)
    return best


def _joined(path: DrivenPath, spans: list[tuple[int, int]]) -> list[PathPart]:
    """Returns the parts of a path: cuts runs to their settled heading, and joins runs without a turn between them."""
    smallest = TURN_RAD[TurnSize.SLIGHT][0]
    settled = [_settled(path, start, end) for start, end in spans]
    edges = [0, *(edge for span in settled for edge in span), len(path) - 1]
    parts: list[PathPart] = []
    for number, (start, end) in enumerate(pairwise(edges)):
        turned = float(path.yaw[end] - path.yaw[start]) if number % 2 == 0 else 0.0
        is_turn = abs(turned) >= smallest
        if is_turn or not parts or parts[-1].turn_rad:
            if is_turn or end > start:
                parts.append(PathPart(start, end, turned if is_turn else 0.0))
        else:
            parts[-1] = parts[-1]._replace(end=end)
    if not parts:
        return [PathPart(0, len(path), 0.0)]
    parts[-1] = parts[-1]._replace(end=len(path))
    return parts


def _settled(path: DrivenPath, start: int, end: int) -> tuple[int, int]:
    """Returns the first and last frame of a run whose heading is close to the median heading of the run."""
    heading = float(np.median(path.yaw[start : end + 1]))
    near: Ints = np.flatnonzero(np.abs(path.yaw[start : end + 1] - heading) < _SETTLED_RAD)
    return start + int(near[0]), start + int(near[-1])
