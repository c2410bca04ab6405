"""Computes which relations to the start pose hold, as masks over all objects, for the generator. Vectorised.

The verifier does not use this module.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np

from schemas.language import thresholds as limit
from schemas.language.expression import AHEAD_SIDES, Relation, ViewSide
from schemas.language.generator.facts import SceneFacts
from schemas.language.generator.masks import Masks, above, below
from schemas.language.graph.view import SceneView
from schemas.support.numpy_types import Bools, Floats, Ints

_ASIDE_TAN, _FACING_TAN = (tuple(math.tan(angle) for angle in band) for band in (limit.DIRECTION_RAD, limit.FACING_RAD))


class _Wayside(NamedTuple):
    """Objects along one side of the way ahead, the straight line along the heading; distances (N,) in metres."""

    masks: Masks
    """Objects that are ahead of the start and beside the way."""
    middle: Floats
    low: Floats
    high: Floats
    """`middle`, `low` and `high`: distances along the heading from the start to the middle, the near end and the far
    end of each object."""
    near: Floats
    """Distance of the near side of each object from the axis of the heading."""

    def hidden(self, numbers: Ints, is_sure: Bools) -> Bools:
        """Returns which objects are hidden from the way ahead by a nearer object for which `is_sure` is true."""
        low, high, near = self.low[numbers], self.high[numbers], self.near[numbers]
        shared = np.minimum(high[:, None], high) - np.maximum(low[:, None], low)
        covers = (shared >= limit.ROW_HIDDEN * (high - low)) & (near >= near[:, None] + limit.ROW_HIDDEN_M)
        return np.asarray((covers & is_sure[:, None]).any(axis=0))


@dataclass(frozen=True)
class ViewFacts:
    """Relations of a scene graph that depend on the start pose."""

    scene: SceneFacts
    view: SceneView

    @cached_property
    def relative(self) -> dict[Relation, Masks]:
        """(N, N) [landmark, object]: left, right, in front, behind as seen from the start."""
        centre, view, count = self.scene.centre, self.view, len(self.scene.centre)
        rows = np.flatnonzero(view.possible)
        seen = centre[rows] - (view.x, view.y)
        axis = seen / np.maximum(np.hypot(seen[:, 0], seen[:, 1]), 1e-6)[:, None]
        offset = centre - centre[rows, None]
        depth = offset[..., 0] * axis[:, None, 0] + offset[..., 1] * axis[:, None, 1]
        side = axis[:, None, 0] * offset[..., 1] - axis[:, None, 1] * offset[..., 0]
        close, distinct = self.scene.close, self.scene.distinct[rows]
        # `sure`: both objects are surely visible
        # `possible`: the landmark may be visible, and the object may be anywhere near the landmark
        sure = close.sure[rows] & distinct & view.sure[rows, None] & view.sure & ~self.scene.stacked[rows]
        possible = close.possible[rows] & distinct
        apart = np.abs(view.bearing - view.bearing[rows, None])
        anywhere = Masks(np.ones(apart.shape, bool), np.ones(apart.shape, bool))
        aligned = below(apart, limit.ALIGNED_RAD)
        hangs = self.scene.graph.hangs
        level = self.scene.has_same_base[rows] & ~(hangs | hangs[rows, None])
        aligned = Masks(aligned.sure & level, aligned.possible)
        relative = {}
        low, high = self._depths(axis)
        own_rows = np.arange(len(rows)), rows
        is_beyond, is_nearer = low >= high[own_rows][:, None], high <= low[own_rows][:, None]
        for name, along, across, shown, (good_tan, bad_tan) in (
            (Relation.LEFT_OF, side, depth, anywhere, _ASIDE_TAN),
            (Relation.RIGHT_OF, -side, depth, anywhere, _ASIDE_TAN),
            (Relation.BEHIND, depth, side, Masks(aligned.sure & is_beyond, aligned.possible), _FACING_TAN),
            (Relation.IN_FRONT_OF, -depth, side, Masks(aligned.sure & is_nearer, aligned.possible), _FACING_TAN),
        ):
            good, bad = np.zeros((count, count), bool), np.zeros((count, count), bool)
            good[rows] = sure & shown.sure & (np.abs(across) <= along * good_tan)
            bad[rows] = possible & shown.possible & (np.abs(across) < along * bad_tan)
            relative[name] = Masks(good, bad)
        return relative

    def _depths(self, axis: Floats) -> tuple[Floats, Floats]:
        """Returns (K, N) smallest and largest distances from the start to each bounding rectangle, measured along each
        of K lines of sight, metres."""
        graph, eye = self.scene.graph, (self.view.x, self.view.y)
        half = (graph.high - graph.low)[:, :2] / 2
        middle, reach = (self.scene.centre - eye) @ axis.T, half @ np.abs(axis.T)
        return (middle - reach).T, (middle + reach).T

    @cached_property
    def distance(self) -> Floats:
        """(N,) distances from the start to the bounding rectangles, metres."""
        graph, eye = self.scene.graph, np.array((self.view.x, self.view.y))
        apart = np.maximum(0, np.maximum(graph.low[:, :2] - eye, eye - graph.high[:, :2]))
        return np.asarray(np.hypot(apart[:, 0], apart[:, 1]))

    @cached_property
    def _ways(self) -> dict[ViewSide, _Wayside]:
        """Objects along both sides of the way ahead."""
        graph, view = self.scene.graph, self.view
        x = np.stack([side[:, 0] for side in (graph.low, graph.high, graph.high, graph.low)], axis=1) - view.x
        y = np.stack([side[:, 1] for side in (graph.low, graph.low, graph.high, graph.high)], axis=1) - view.y
        cos, sin = math.cos(view.yaw), math.sin(view.yaw)
        along, left = x * cos + y * sin, y * cos - x * sin
        middle = along.mean(axis=1)
        room = graph.room_of
        here = Masks((room == view.room) & (room > 0), (room == view.room) | (room == 0) | (view.room == 0))
        here = here.both(above(middle, limit.ROW_AHEAD_M))
        ways = {}
        for side, sign in AHEAD_SIDES.items():
            near, far = (sign * left).min(axis=1), (sign * left).max(axis=1)
            aside = Masks(near >= limit.ROW_ASIDE_M.good, far > limit.ROW_ASIDE_M.bad)
            masks = here.both(aside).both(below(near, limit.ROW_GAP_M))
            ways[side] = _Wayside(masks, middle, low=along.min(axis=1), high=along.max(axis=1), near=near)
        return ways

    def row(self, among: Masks, side: ViewSide, number: int) -> list[int]:
        """Returns the objects along one side of the way ahead, in order, up to the first whose place is not certain.

        Args:
            among: objects to count.
            side: side of the way ahead.
            number: object to find; the result is empty unless it surely is beside the way and visible at least in part.
        """
        way = self._ways[side]
        if not (way.masks.sure[number] and self.view.shown[number]):
            return []
        nearer = among.both(way.masks)
        numbers = np.flatnonzero(nearer.possible)
        is_hidden = way.hidden(numbers, nearer.sure[numbers]) & ~self.view.shown[numbers]
        numbers = numbers[~is_hidden]
        order = numbers[np.argsort(way.middle[numbers], kind="stable")].tolist()
        certain: list[int] = []
        for place, each in enumerate(order):
            nearby = order[max(place - 1, 0) : place] + order[place + 1 : place + 2]
            is_apart = all(abs(way.middle[each] - way.middle[other]) >= limit.ROW_STEP_M for other in nearby)
            if not (nearer.sure[each] and self.view.shown[each] and is_apart):
                break
            certain.append(each)
        return certain

    @cached_property
    def ego(self) -> dict[Relation, Masks]:
        """(N,) objects on the left, on the right and straight ahead."""
        view, egocentric = self.view, {}
        room = self.scene.graph.room_of
        here = view.possible | (room == view.room) | (room == 0)
        beyond = below(np.abs(view.bearing), limit.EGO_BEHIND_RAD)
        for name, sign in ((Relation.YOUR_LEFT, 1.0), (Relation.YOUR_RIGHT, -1.0)):
            aside = above(sign * view.bearing, limit.EGO_RAD).both(beyond)
            egocentric[name] = aside.both(Masks(view.sure, here))
        egocentric[Relation.AHEAD] = below(np.abs(view.bearing), limit.AHEAD_RAD).both(Masks(view.sure, here))
        return egocentric
