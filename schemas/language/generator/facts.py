"""Computes which relations hold in a scene graph, as masks over all objects, for the generator. Vectorised.

`view_facts` computes the relations to the start pose. The verifier does not use this module.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from schemas.language import thresholds as limit
from schemas.language.expression import Landmark, Relation
from schemas.language.generator.masks import Described, Masks, above, below
from schemas.language.graph.scene_graph import SceneGraph, SceneObject, SurfaceTop
from schemas.language.kinds import UNKNOWN, may_be_called
from schemas.support.numpy_types import Bools, Floats


@dataclass(frozen=True)
class SceneFacts:
    """Properties and relations of a scene graph that do not depend on the start pose.

    Objects or pairs for which a relation is only possible are in the mask `possible` and not in `sure`, see `Masks`.
    """

    graph: SceneGraph

    @cached_property
    def _kind_masks(self) -> dict[tuple[str, str | None, str | None], Masks]:
        return {}

    def described(self, kind: str, colour: str | None, material: str | None = None) -> Masks:
        """Returns the objects of a kind or superclass that have the colour and the material, where these are given."""
        key = kind, colour, material
        if key not in self._kind_masks:
            table, objects = self.graph.kinds, self.graph.objects
            inside, alike = table.kinds_of(kind), table.borderline_of(kind)
            is_kind = np.array([each.kind in inside for each in objects], bool)
            looks = np.array([each.looks in inside for each in objects], bool)
            sure = is_kind & (looks | np.array([each.looks is None for each in objects], bool))
            shows = np.array([not inside.isdisjoint(each.shows) for each in objects], bool)
            possible = is_kind | looks | shows | np.array([each.kind in alike for each in objects], bool)
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
        landmarks = []
        for number, each in enumerate(self.graph.objects):
            has_colour = self.graph.kinds.of(each.kind).plain and each.colour != UNKNOWN
            nouns = []
            for colour in (None, each.colour) if has_colour else (None,):
                masks = self.described(each.kind, colour)
                landmark = Landmark(kind=each.kind, colour=colour, definite=masks.fits_only(number))
                nouns.append(Described(landmark, masks, np.flatnonzero(masks.sure), np.flatnonzero(masks.possible)))
            landmarks.append(tuple(nouns))
        return tuple(landmarks)

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
        """(N, N) pairs in one room; both masks include each pair with an object whose room is unknown."""
        room = self.graph.room_of
        same = (room[:, None] == room) | (room[:, None] == 0) | (room == 0)
        return Masks(same, same)

    @cached_property
    def same_room(self) -> Masks:
        """(N, N) pairs in one room; pairs with a wide opening between them or an unknown room are only `possible`."""
        room, area = self.graph.room_of, self.graph.area_of
        known = (room > 0) & (area > 0)
        sure = (room[:, None] == room) & (area[:, None] == area) & known[:, None] & known
        return Masks(sure, (room[:, None] == room) | (room[:, None] == 0) | (room == 0))

    @cached_property
    def close(self) -> Masks:
        """(N, N) pairs that are close enough for left, right, in front and behind."""
        close = below(self.gap, limit.DIRECTION_GAP_M).both(self._rooms)
        return Masks(close.sure & self._is_level, close.possible & self._is_level)

    @cached_property
    def distinct(self) -> Bools:
        """(N, N) pairs of two different objects."""
        return ~np.eye(len(self.graph.objects), dtype=bool)

    @cached_property
    def next_to(self) -> Masks:
        """(N, N) [landmark, object]: objects next to a landmark, neither on nor under it."""
        adjacent = below(self.gap, limit.NEXT_TO_M).both(self._rooms)
        sure = adjacent.sure & self.distinct & ~self.stacked & self._is_level & ~self.graph.walled
        return Masks(sure, adjacent.possible & self.distinct)

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
        inside = above(share, limit.OVERLAP)
        rest = np.abs(low[:, 2] - high[:, None, 2])
        on = inside.both(below(rest, limit.TOUCH_M))
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
        is_stacked = self.support[Relation.ON].possible | self.support[Relation.UNDER].possible
        return np.asarray(is_stacked | is_stacked.T)

    @cached_property
    def alone(self) -> dict[Relation, Masks]:
        """For each relation that needs neither a landmark nor a view: (N,) objects for which it holds."""
        objects = self.graph.objects
        gap, corner = (np.array([getattr(each, name) for each in objects]) for name in ("wall_gap_m", "corner_gap_m"))
        hung = below(gap, limit.TOUCH_M).both(above(self._base, limit.WALL_BASE_M))
        stands = self.support[Relation.ON].possible.any(axis=0) if len(objects) else np.zeros(0, bool)
        corners = below(corner, limit.CORNER_M)
        return {
            Relation.ON_WALL: Masks(hung.sure & ~stands, hung.possible),
            Relation.IN_CORNER: corners,
            **self._states,
        }

    @cached_property
    def _states(self) -> dict[Relation, Masks]:
        """(N,) objects whose flat top is empty, and objects with something on it."""
        objects = self.graph.objects
        known = np.array([each.top is not None for each in objects], bool)
        free = np.array([each.top is not None and not each.top.above for each in objects], bool)
        occupied = np.array([each.top is not None and _is_occupied(each.top, each) for each in objects], bool)
        return {Relation.EMPTY: Masks(free, ~known | ~occupied), Relation.OCCUPIED: Masks(occupied, ~known | ~free)}

    def counted(self, relation: Relation, kind: str, count: int) -> Masks:
        """Returns the objects that have exactly `count` objects of a kind beside or on them."""
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
        """(N, N) [object, thing]: things close to an object, and clearly farther from every other object with a top."""
        beside = below(self.gap, limit.BESIDE_M).both(self._rooms)
        surfaces = np.array([self.graph.kinds.of(each.kind).surface for each in self.graph.objects], bool)
        others = np.where(surfaces[:, None] & self.distinct, self.gap, np.inf)  # (N, N) [other object, thing]
        nearest = np.sort(others, axis=0)[:2] if len(others) > 1 else np.full((2, len(others)), np.inf)
        # (N, N) [object, thing]: gap between a thing and the nearest object with a top, other than the given object
        second = np.where(others <= nearest[0], nearest[1], nearest[0])
        clear = second >= self.gap + limit.BESIDE_OTHER_M
        level = self._is_level & self.distinct & ~self.support[Relation.ON].possible
        apart = self.distinct & ~self.support[Relation.ON].sure
        return Masks(beside.sure & clear & level, beside.possible & apart)

    def in_room(self, room: int, area: int | None = None) -> Masks:
        """Returns the objects in a room; if a part of the room is given, objects in other parts are only `possible`."""
        labels = self.graph.room_of
        sure = labels == room
        if area is not None:
            sure = sure & (self.graph.area_of == area) & (area > 0)
        return Masks(sure, (labels == room) | (labels == 0))

    def in_typed_room(self, room: int) -> Masks:
        """Returns the objects in a room; those in parts that do not show the room's type are only `possible`."""
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
        start, way = self.centre[first], self.centre[second] - self.centre[first]
        length = float(np.hypot(*way))
        if length < 0.5 or length >= limit.BETWEEN_SPAN_M.bad:
            nothing = np.zeros(len(self.centre), bool)
            return Masks(nothing, nothing)
        offset = self.centre - start
        along = offset @ way / length**2
        across = np.abs(offset[:, 0] * way[1] - offset[:, 1] * way[0]) / length**2
        between = above(np.minimum(along, 1 - along), limit.BETWEEN_ALONG).both(below(across, limit.BETWEEN_ACROSS))
        rooms = Masks(self._rooms.sure[first] & self._rooms.sure[second], self._rooms.possible[first])
        apart = self.distinct[first] & self.distinct[second]
        near = length <= limit.BETWEEN_SPAN_M.good and not self.graph.walled[first, second]
        between = between.both(rooms)
        return Masks(between.sure & apart & near, between.possible & apart)


def _is_occupied(top: SurfaceTop, each: SceneObject) -> bool:
    """Returns whether a thing surely rests on a top: within the bounding rectangle, and large enough to be seen."""
    low, high = (np.array([box[side] for box in top.above]).reshape(-1, 3) for side in (0, 1))
    middle, lift, size = (low + high)[:, :2] / 2, low[:, 2] - top.height_m, (high - low).max(axis=1, initial=0.0)
    inside = ((middle > each.low_m[:2]) & (middle < each.high_m[:2])).all(axis=1)
    rests = (lift >= limit.REST_M[0]) & (lift <= limit.REST_M[1])
    return bool((inside & rests & (size >= limit.THING_M)).any())
