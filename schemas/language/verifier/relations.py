"""Decides from footprint, room and view whether a relation holds for one object of a scene graph.

Independent of the generator. Reads neither words nor expressions.
"""

from __future__ import annotations

from collections.abc import Set

from schemas.language import thresholds as limit
from schemas.language.expression import Relation
from schemas.language.graph.scene_graph import SceneGraph
from schemas.language.graph.view import SceneView
from schemas.language.verifier.measure import Footprints, Truth, angle_between, at_least, at_most
from schemas.language.verifier.selection import Selected


class ObjectRelations:
    """Relations between the objects of one scene; objects are given by their numbers in the graph.

    Args:
        graph: scene graph.
        prints: footprints of its objects.
    """

    def __init__(self, graph: SceneGraph, prints: Footprints) -> None:
        self._graph, self._prints = graph, prints

    def is_in_parts(self, number: int, room: int, areas: Set[int]) -> Truth:
        """Returns whether an object is in a room: `YES` in the given parts of the room, `MAYBE` in its other parts."""
        each = self._graph.objects[number]
        if each.room == room:
            return Truth.YES if each.area in areas else Truth.MAYBE
        return Truth.NO if each.room else Truth.MAYBE

    def is_in_room(self, number: int, room: int) -> Truth:
        """Returns whether an object is in a room; 0 is an unknown room."""
        own_room = self._graph.objects[number].room
        return Truth.MAYBE if not room or not own_room else Truth.YES if own_room == room else Truth.NO

    def is_beside(self, number: int, thing: int) -> Truth:
        """Returns whether a thing is close to an object, and clearly farther from every other object with a top."""
        if self._same_room(number, thing) is Truth.NO or self._prints.rests_on(thing, number) is Truth.YES:
            return Truth.NO
        gap = self._prints.gap(number, thing)
        close = at_most(gap, limit.BESIDE_M)
        if close is not Truth.YES:
            return close
        others = (
            other
            for other, each in enumerate(self._graph.objects)
            if other not in (number, thing) and self._graph.kinds.of(each.kind).surface
        )
        is_clear = all(self._prints.gap(other, thing) >= gap + limit.BESIDE_OTHER_M for other in others)
        is_level = not self._prints.is_apart(number, thing) and self._prints.rests_on(thing, number) is Truth.NO
        return Truth.YES if is_clear and is_level else Truth.MAYBE

    def from_viewer(self, relation: Relation, number: int, view: SceneView) -> Truth:
        """Returns whether an object is ahead of the viewer, or on the left or right."""
        bearing = float(view.bearing[number])
        shown = Truth.YES if view.sure[number] else Truth.MAYBE if view.possible[number] else Truth.NO
        room = self._graph.objects[number].room
        if shown is Truth.NO and room in (0, view.room):
            shown = Truth.MAYBE
        if relation is Relation.AHEAD:
            return min(shown, at_most(abs(bearing), limit.AHEAD_RAD))
        aside = bearing if relation is Relation.YOUR_LEFT else -bearing
        return min(shown, at_least(aside, limit.EGO_RAD), at_most(abs(bearing), limit.EGO_BEHIND_RAD))

    def _same_room(self, number: int, other: int) -> Truth:
        one, two = self._graph.objects[number].room, self._graph.objects[other].room
        if not one or not two:
            return Truth.MAYBE
        return Truth.YES if one == two else Truth.NO

    def _is_undivided(self, number: int, other: int) -> bool:
        """Returns whether two objects surely are in one part of a room, with no wide opening between them."""
        one, two = self._graph.objects[number].area, self._graph.objects[other].area
        return one == two != 0

    def holds(self, relation: Relation, number: int, other: int, view: SceneView | None) -> Truth:
        if relation is Relation.SAME_ROOM:
            together = self._same_room(number, other)
            return together if self._is_undivided(number, other) else min(together, Truth.MAYBE)
        if relation is Relation.ON:
            return self._prints.rests_on(number, other)
        if relation is Relation.UNDER:
            return self._prints.is_under(number, other)
        together = self._same_room(number, other)
        if together is Truth.MAYBE:  # a door or a window is in no room, but other objects may be next to it
            together = Truth.YES
        if together is Truth.NO:
            return Truth.NO
        if relation is Relation.NEXT_TO:
            truth = at_most(self._prints.gap(number, other), limit.NEXT_TO_M)
            is_doubtful = self._graph.walled[number, other] or self._prints.is_stacked(number, other)
            return Truth.MAYBE if truth is Truth.YES and is_doubtful else truth
        assert view is not None
        if not view.possible[other]:
            return Truth.NO
        if self._prints.is_apart(number, other):
            return Truth.NO
        is_seen = view.sure[number] and view.sure[other] and not self._prints.is_stacked(number, other)
        shown = Truth.YES if is_seen else Truth.MAYBE
        way = self._way(relation, number, other, view)
        if way is Truth.NO:
            return Truth.NO
        return min(shown, way, at_most(self._prints.gap(number, other), limit.DIRECTION_GAP_M))

    def _way(self, relation: Relation, number: int, other: int, view: SceneView) -> Truth:
        """Returns whether an object is in the direction of a relation from a landmark, as seen from the start."""
        eye = view.x, view.y
        angle = self._prints.direction(number, other, eye)
        turn = {Relation.LEFT_OF: 90.0, Relation.RIGHT_OF: -90.0, Relation.BEHIND: 0.0, Relation.IN_FRONT_OF: 180.0}
        aside = angle_between(angle, turn[relation])
        if relation in (Relation.LEFT_OF, Relation.RIGHT_OF):
            return at_most(aside, limit.DIRECTION_RAD)
        apart = abs(float(view.bearing[number] - view.bearing[other]))
        way = min(at_most(aside, limit.FACING_RAD), at_most(apart, limit.ALIGNED_RAD))
        near, far = (number, other) if relation is Relation.IN_FRONT_OF else (other, number)
        stands = not (self._graph.hangs[number] or self._graph.hangs[other])
        is_clear = (
            self._prints.has_same_base(number, other) and self._prints.is_nearer(near, far, eye, other) and stands
        )
        return way if is_clear else min(way, Truth.MAYBE)

    def is_between(self, number: int, first: int, second: int) -> Truth:
        rooms = {self._graph.objects[each].room for each in (number, first, second)} - {0}
        if len(rooms) > 1:
            return Truth.NO
        truth = self._prints.between(number, first, second)
        return min(truth, Truth.MAYBE) if self._graph.walled[first, second] else truth

    def is_near_enough(self, number: int, other: int, way: Selected) -> Truth:
        """Returns `MAYBE` if an object that is called the nearest to a landmark is not in the landmark's room, or a
        wall is between them; otherwise `YES`."""
        if way is Selected.MOST:
            return Truth.YES
        is_far = self._same_room(number, other) is Truth.NO or self._graph.walled[number, other]
        return Truth.MAYBE if is_far else Truth.YES
