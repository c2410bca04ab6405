"""Computes which relations hold in a scene graph, as masks over all objects, for the generator. Vectorised.

Every relation has two masks: where it surely holds, and where it possibly holds. The verifier does not use this module.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np

from schemas.language import thresholds as limit
from schemas.language.expression import AHEAD_SIDES, Landmark, Relation, ViewSide
from schemas.language.graph.scene_graph import SceneGraph, SceneObject
from schemas.language.graph.tops import SurfaceTop
from schemas.language.graph.view import SceneView
from schemas.language.kinds import UNKNOWN, may_be_called
from schemas.language.thresholds import Band
from schemas.support.numpy_types import Bools, Floats, Ints

_ASIDE_TAN, _FACING_TAN = (tuple(math.tan(angle) for angle in band) for band in (limit.DIRECTION_RAD, limit.FACING_RAD))


class Masks(NamedTuple):
    """Objects for which a property holds; arrays of any shape whose last axis is the object."""

    sure: Bools
    """Objects for which it surely holds."""
    possible: Bools
    """Objects for which it possibly holds; includes those for which it surely holds."""

    def both(self, other: Masks) -> Masks:
        """Returns the masks of both properties together."""
        return Masks(self.sure & other.sure, self.possible & other.possible)

    def of_any(self, landmarks: Described) -> Masks:
        """Returns which objects have the relation of (N, N) masks to any of the landmarks."""
        sure = np.asarray(self.sure[landmarks.sure].any(axis=0), bool)
        return Masks(sure, np.asarray(self.possible[landmarks.possible].any(axis=0), bool))

    def fits_only(self, number: int) -> bool:
        """Returns whether the property surely holds for one object, and possibly for no other."""
        return bool(self.sure[number]) and int(self.possible.sum()) == 1


class Described(NamedTuple):
    """Description of a landmark, and the objects that it fits."""

    landmark: Landmark
    """Description."""
    masks: Masks
    """Objects that it fits."""
    sure: Ints
    """Numbers of the objects that it surely fits."""
    possible: Ints
    """Numbers of the objects that it possibly fits."""


def _below(values: Floats, band: Band) -> Masks:
    return Masks(values <= band.good, values < band.bad)


def _above(values: Floats, band: Band) -> Masks:
    return Masks(values >= band.good, values > band.bad)


@dataclass(frozen=True)
class SceneFacts:
    """Properties and relations of a scene graph that do not depend on the start pose."""

    graph: SceneGraph

    @cached_property
    def _kind_masks(self) -> dict[tuple[str, str | None, str | None], Masks]:
        return {}

    def described(self, kind: str, colour: str | None, material: str | None = None) -> Masks:
        """Returns which objects a kind or superclass fits, with a colour and a material if they are given."""
        key = kind, colour, material
        if key not in self._kind_masks:
            table, objects = self.graph.kinds, self.graph.objects
            inside, alike = table.kinds_of(kind), table.borderline_of(kind)
            own = np.array([each.kind in inside for each in objects], bool)
            looks = np.array([each.looks in inside for each in objects], bool)
            sure = own & (looks | np.array([each.looks is None for each in objects], bool))
            shows = np.array([not inside.isdisjoint(each.shows) for each in objects], bool)
            possible = own | looks | shows | np.array([each.kind in alike for each in objects], bool)
            if colour is not None:
                same = np.array([each.colour == colour for each in objects], bool)
                sure &= same
                possible &= np.array([may_be_called(each.colour, colour) for each in objects], bool)
            if material is not None:
                sure &= np.array([each.materials[:1] == (material,) for each in objects], bool)
                known = np.array([bool(each.materials) and UNKNOWN not in each.materials for each in objects], bool)
                possible &= ~known | np.array([material in each.materials for each in objects], bool)
            self._kind_masks[key] = Masks(sure, possible)
        return self._kind_masks[key]

    @cached_property
    def landmarks(self) -> tuple[tuple[Described, ...], ...]:
        """Short descriptions of each object: its kind, and its kind and colour."""
        found = []
        for number, each in enumerate(self.graph.objects):
            has_colour = self.graph.kinds.of(each.kind).plain and each.colour != UNKNOWN
            own = []
            for colour in (None, each.colour) if has_colour else (None,):
                masks = self.described(each.kind, colour)
                landmark = Landmark(kind=each.kind, colour=colour, definite=masks.fits_only(number))
                own.append(Described(landmark, masks, np.flatnonzero(masks.sure), np.flatnonzero(masks.possible)))
            found.append(tuple(own))
        return tuple(found)

    @cached_property
    def centre(self) -> Floats:
        """(N, 2) centres of the bounding rectangles, metres."""
        return np.asarray((self.graph.low + self.graph.high)[:, :2] / 2)

    @cached_property
    def volume(self) -> Floats:
        """(N,) areas of the footprints times the heights, cubic metres; bounding boxes may be larger."""
        outlines = [np.array(each.outline_m) for each in self.graph.objects]
        ahead = [np.roll(outline, -1, axis=0) for outline in outlines]
        areas = [np.sum(a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]) / 2 for a, b in zip(outlines, ahead, strict=True)]
        return np.asarray(areas) * self.height

    @cached_property
    def height(self) -> Floats:
        """(N,) heights, metres."""
        return np.asarray((self.graph.high - self.graph.low)[:, 2])

    @cached_property
    def gap(self) -> Floats:
        """(N, N) gap between bounding rectangles, metres."""
        low, high = self.graph.low[:, None, :2], self.graph.high[:, None, :2]
        apart = np.maximum(0, np.maximum(low - high.transpose(1, 0, 2), low.transpose(1, 0, 2) - high))
        return np.asarray(np.hypot(apart[..., 0], apart[..., 1]))

    @cached_property
    def _rooms(self) -> Masks:
        """Pairs that are surely and possibly in one room."""
        room = self.graph.room_of
        same, unknown = room[:, None] == room, (room[:, None] == 0) | (room == 0)
        return Masks((same & ~unknown) | unknown, same | unknown)

    @cached_property
    def same_room(self) -> Masks:
        """(N, N) pairs that are surely in one room without a wide opening between them, and those that possibly are."""
        room, area = self.graph.room_of, self.graph.area_of
        known = (room > 0) & (area > 0)
        sure = (room[:, None] == room) & (area[:, None] == area) & known[:, None] & known
        return Masks(sure, (room[:, None] == room) | (room[:, None] == 0) | (room == 0))

    @cached_property
    def close(self) -> Masks:
        """(N, N) pairs that are close enough for left, right, in front and behind."""
        found = _below(self.gap, limit.DIRECTION_GAP_M).both(self._rooms)
        return Masks(found.sure & self._is_level, found.possible & self._is_level)

    @cached_property
    def distinct(self) -> Bools:
        """(N, N) pairs of two objects."""
        return ~np.eye(len(self.graph.objects), dtype=bool)

    @cached_property
    def next_to(self) -> Masks:
        """(N, N) [landmark, object]: objects next to a landmark, neither on nor under it."""
        found = _below(self.gap, limit.NEXT_TO_M).both(self._rooms)
        sure = found.sure & self.distinct & ~self.stacked & self._is_level & ~self.graph.walled
        return Masks(sure, found.possible & self.distinct)

    @cached_property
    def _is_level(self) -> Bools:
        return np.asarray(np.abs(self._base[:, None] - self._base) < limit.LEVEL_M)

    @cached_property
    def has_same_base(self) -> Bools:
        """(N, N) pairs whose lower sides have a similar height."""
        return np.asarray(np.abs(self._base[:, None] - self._base) < limit.SAME_BASE_M)

    @cached_property
    def _base(self) -> Floats:
        return np.array([each.base_m for each in self.graph.objects])

    @cached_property
    def support(self) -> dict[Relation, Masks]:
        """(N, N) [landmark, object]: objects on and under a landmark."""
        low, high = self.graph.low, self.graph.high
        side = np.minimum(high[:, None, :2], high[:, :2]) - np.maximum(low[:, None, :2], low[:, :2])
        area = np.prod(np.maximum(side, 0), axis=-1)
        share = area / np.maximum(np.prod((high - low)[:, :2], axis=-1), 1e-6)
        inside = _above(share, limit.OVERLAP)
        rest = np.abs(low[:, 2] - high[:, None, 2])
        on = inside.both(_below(rest, limit.TOUCH_M))
        top = high[:, 2] - high[:, None, 2]
        grounded = (low[:, 2] - self.graph.floor_m) < limit.TOUCH_M.good
        under = Masks(
            inside.sure & (top < 0.02) & grounded, inside.possible & (top < 0.3) & (low[:, 2] < high[:, None, 2])
        )
        clear = self.distinct
        return {
            Relation.ON: Masks(on.sure & clear, on.possible & clear),
            Relation.UNDER: Masks(under.sure & clear & ~on.possible, under.possible & clear),
        }

    @cached_property
    def stacked(self) -> Bools:
        """(N, N) pairs of which one object may be on or under the other."""
        found = self.support[Relation.ON].possible | self.support[Relation.UNDER].possible
        return np.asarray(found | found.T)

    @cached_property
    def alone(self) -> dict[Relation, Masks]:
        """(N,) relations without landmark and view."""
        objects = self.graph.objects
        gap, corner = (np.array([getattr(each, name) for each in objects]) for name in ("wall_gap_m", "corner_gap_m"))
        hung = _below(gap, limit.TOUCH_M).both(_above(self._base, limit.WALL_BASE_M))
        stands = self.support[Relation.ON].possible.any(axis=0) if len(objects) else np.zeros(0, bool)
        corners = _below(corner, limit.CORNER_M)
        return {
            Relation.ON_WALL: Masks(hung.sure & ~stands, hung.possible),
            Relation.IN_CORNER: corners,
            **self._states,
        }

    @cached_property
    def _states(self) -> dict[Relation, Masks]:
        """(N,) objects with nothing, and with something on their flat top."""
        objects = self.graph.objects
        known = np.array([each.top is not None for each in objects], bool)
        free = np.array([each.top is not None and not each.top.above for each in objects], bool)
        laden = np.array([each.top is not None and _is_laden(each.top, each) for each in objects], bool)
        return {Relation.EMPTY: Masks(free, ~known | ~laden), Relation.LADEN: Masks(laden, ~known | ~free)}

    def counted(self, relation: Relation, kind: str, count: int) -> Masks:
        """Returns which objects have an exact number of objects of a kind beside or on them."""
        key = relation, kind, count
        if key not in self._counted:
            fitting = self.described(kind, None)
            pairs = self._beside if relation is Relation.WITH_BESIDE else self._carried
            sure = (pairs.sure & fitting.sure).sum(axis=1)
            possible = (pairs.possible & fitting.possible).sum(axis=1)
            self._counted[key] = Masks((sure == count) & (possible == count), (sure <= count) & (possible >= count))
        return self._counted[key]

    @cached_property
    def _counted(self) -> dict[tuple[Relation, str, int], Masks]:
        return {}

    @cached_property
    def _carried(self) -> Masks:
        """(N, N) [object, thing]: things on the top of an object."""
        return self.support[Relation.ON]

    @cached_property
    def _beside(self) -> Masks:
        """(N, N) [object, thing]: things close to an object and to no other object of a kind with a top."""
        found = _below(self.gap, limit.BESIDE_M).both(self._rooms)
        surfaces = np.array([self.graph.kinds.of(each.kind).surface for each in self.graph.objects], bool)
        others = np.where(surfaces[:, None] & self.distinct, self.gap, np.inf)  # [other, thing]
        nearest = np.sort(others, axis=0)[:2] if len(others) > 1 else np.full((2, len(others)), np.inf)
        second = np.where(others <= nearest[0], nearest[1], nearest[0])  # the smallest gap of a thing to another object
        clear = second >= self.gap + limit.BESIDE_OTHER_M
        level = self._is_level & self.distinct & ~self.support[Relation.ON].possible
        apart = self.distinct & ~self.support[Relation.ON].sure
        return Masks(found.sure & clear & level, found.possible & apart)

    def in_room(self, room: int, area: int | None = None) -> Masks:
        """Returns which objects are in a room; surely those of the same part of it, if a part is given."""
        found = self.graph.room_of
        sure = found == room
        if area is not None:
            sure = sure & (self.graph.area_of == area) & (area > 0)
        return Masks(sure, (found == room) | (found == 0))

    def in_typed_room(self, room: int) -> Masks:
        """Returns which objects are in a room of a type; surely those in the parts that show the type."""
        kind = self.graph.types[room - 1]
        shown = self.graph.areas_of_type(room, str(kind))
        return Masks(
            (self.graph.room_of == room) & np.isin(self.graph.area_of, list(shown)), self.in_room(room).possible
        )

    def is_between(self, number: int, first: int, second: int) -> bool:
        """Returns whether an object surely is between two others; cheaper than `between`."""
        start, end, middle = self.centre[[first, second, number]].tolist()
        length = math.dist(start, end)
        if not 0.5 <= length <= limit.BETWEEN_SPAN_M.good:
            return False
        detour = math.dist(start, middle) + math.dist(middle, end)
        return detour < 1.2 * length and bool(self.between(first, second).sure[number])

    def between(self, first: int, second: int) -> Masks:
        """Returns which objects are between two objects."""
        start, way = self.centre[first], self.centre[second] - self.centre[first]
        length = float(np.hypot(*way))
        if length < 0.5 or length >= limit.BETWEEN_SPAN_M.bad:
            nothing = np.zeros(len(self.centre), bool)
            return Masks(nothing, nothing)
        offset = self.centre - start
        along = offset @ way / length**2
        across = np.abs(offset[:, 0] * way[1] - offset[:, 1] * way[0]) / length**2
        found = _above(np.minimum(along, 1 - along), limit.BETWEEN_ALONG).both(_below(across, limit.BETWEEN_ACROSS))
        rooms = Masks(self._rooms.sure[first] & self._rooms.sure[second], self._rooms.possible[first])
        apart = self.distinct[first] & self.distinct[second]
        near = length <= limit.BETWEEN_SPAN_M.good and not self.graph.walled[first, second]
        found = found.both(rooms)
        return Masks(found.sure & apart & near, found.possible & apart)


def _is_laden(top: SurfaceTop, each: SceneObject) -> bool:
    """Returns whether a thing surely rests on a top: within the bounding rectangle, and large enough to be seen."""
    low, high = (np.array([box[side] for box in top.above]).reshape(-1, 3) for side in (0, 1))
    middle, lift, size = (low + high)[:, :2] / 2, low[:, 2] - top.height_m, (high - low).max(axis=1, initial=0.0)
    inside = ((middle > each.low_m[:2]) & (middle < each.high_m[:2])).all(axis=1)
    rests = (lift >= limit.REST_M[0]) & (lift <= limit.REST_M[1])
    return bool((inside & rests & (size >= limit.THING_M)).any())


class _Wayside(NamedTuple):
    """Objects along one side of the way ahead; distances (N,) in metres."""

    masks: Masks
    """Objects ahead and beside the way."""
    middle: Floats
    low: Floats
    high: Floats
    """Distances of the middle and both ends along the heading."""
    near: Floats
    """Distance of the near side from the axis of the heading."""

    def hidden(self, numbers: Ints, is_sure: Bools) -> Bools:
        """Returns which of some objects another one that is surely counted is in front of, as seen from the axis."""
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
        # the landmark is seen; the object is seen or may be somewhere else in the same room
        sure = close.sure[rows] & distinct & view.sure[rows, None] & view.sure & ~self.scene.stacked[rows]
        possible = close.possible[rows] & distinct
        apart = np.abs(view.bearing - view.bearing[rows, None])
        anywhere = Masks(np.ones(apart.shape, bool), np.ones(apart.shape, bool))
        aligned = _below(apart, limit.ALIGNED_RAD)
        hangs = self.scene.graph.hangs
        level = self.scene.has_same_base[rows] & ~(hangs | hangs[rows, None])
        aligned = Masks(aligned.sure & level, aligned.possible)
        found = {}
        low, high = self._depths(axis)
        own = np.arange(len(rows)), rows
        is_beyond, is_nearer = low >= high[own][:, None], high <= low[own][:, None]
        for name, along, across, shown, (good_tan, bad_tan) in (
            (Relation.LEFT_OF, side, depth, anywhere, _ASIDE_TAN),
            (Relation.RIGHT_OF, -side, depth, anywhere, _ASIDE_TAN),
            (Relation.BEHIND, depth, side, Masks(aligned.sure & is_beyond, aligned.possible), _FACING_TAN),
            (Relation.IN_FRONT_OF, -depth, side, Masks(aligned.sure & is_nearer, aligned.possible), _FACING_TAN),
        ):
            good, bad = np.zeros((count, count), bool), np.zeros((count, count), bool)
            good[rows] = sure & shown.sure & (np.abs(across) <= along * good_tan)
            bad[rows] = possible & shown.possible & (np.abs(across) < along * bad_tan)
            found[name] = Masks(good, bad)
        return found

    def _depths(self, axis: Floats) -> tuple[Floats, Floats]:
        """Returns (K, N) smallest and largest distances of the bounding rectangles along K axes of sight, metres."""
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
        here = here.both(_above(middle, limit.ROW_AHEAD_M))
        found = {}
        for side, sign in AHEAD_SIDES.items():
            near, far = (sign * left).min(axis=1), (sign * left).max(axis=1)
            aside = Masks(near >= limit.ROW_ASIDE_M.good, far > limit.ROW_ASIDE_M.bad)
            masks = here.both(aside).both(_below(near, limit.ROW_GAP_M))
            found[side] = _Wayside(masks, middle, along.min(axis=1), along.max(axis=1), near)
        return found

    def row(self, among: Masks, side: ViewSide, number: int) -> list[int]:
        """Returns the objects that are counted along one side of the way ahead, up to the first that is not certain.

        Args:
            among: objects to count.
            side: side of the way ahead.
            number: object that is looked for; without it, or if no part of it is surely visible, nothing is counted.
        """
        way = self._ways[side]
        if not (way.masks.sure[number] and self.view.shown[number]):
            return []
        found = among.both(way.masks)
        numbers = np.flatnonzero(found.possible)
        is_hidden = way.hidden(numbers, found.sure[numbers]) & ~self.view.shown[numbers]
        numbers = numbers[~is_hidden]
        order = numbers[np.argsort(way.middle[numbers], kind="stable")].tolist()
        certain: list[int] = []
        for place, each in enumerate(order):
            nearby = order[max(place - 1, 0) : place] + order[place + 1 : place + 2]
            is_apart = all(abs(way.middle[each] - way.middle[other]) >= limit.ROW_STEP_M for other in nearby)
            if not (found.sure[each] and self.view.shown[each] and is_apart):
                break
            certain.append(each)
        return certain

    @cached_property
    def ego(self) -> dict[Relation, Masks]:
        """(N,) on the left, on the right, straight ahead."""
        view, found = self.view, {}
        room = self.scene.graph.room_of
        here = view.possible | (room == view.room) | (room == 0)
        beyond = _below(np.abs(view.bearing), limit.EGO_BEHIND_RAD)
        for name, sign in ((Relation.YOUR_LEFT, 1.0), (Relation.YOUR_RIGHT, -1.0)):
            aside = _above(sign * view.bearing, limit.EGO_RAD).both(beyond)
            found[name] = aside.both(Masks(view.sure, here))
        found[Relation.AHEAD] = _below(np.abs(view.bearing), limit.AHEAD_RAD).both(Masks(view.sure, here))
        return found
