"""Decides which objects of a scene graph an expression fits, and whether a sentence fits its target.

Independent of the generator: it reads the sentence again, measures footprints as polygons one by one, and follows the
definitions in docs/language/reference.md. It shares the thresholds, the graph and the words with the generator.

Design: docs/design/language.md#sentences-are-verified-by-parsing.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

from schemas.language import thresholds as limit
from schemas.language.expression import AHEAD_SIDES, SUPERLATIVES, Clause, Expression, Landmark, Relation
from schemas.language.graph.scene_graph import SceneGraph
from schemas.language.graph.view import SceneView
from schemas.language.kinds import UNKNOWN, may_be_called
from schemas.language.sentence.reading import Reader, Reading
from schemas.language.verifier.measure import Footprints, Truth, at_least, at_most
from schemas.language.verifier.relations import ObjectRelations
from schemas.language.verifier.selection import Selected, by_size, counted, counted_ahead, extreme


class FittingObjects(NamedTuple):
    """Objects that an expression fits, by their number in the scene graph."""

    sure: frozenset[int]
    """Objects that it surely fits."""
    possible: frozenset[int]
    """Objects that it possibly fits; includes those that it surely fits."""
    fault: str = ""
    """Reason why the expression has no meaning in the scene, such as a landmark that is not unique."""

    def fits_only(self, number: int) -> bool:
        return not self.fault and self.sure == self.possible == {number}

    def fits_any(self, number: int) -> bool:
        """Returns whether the expression fits an object, perhaps among others, and has no borderline cases."""
        return not self.fault and self.sure == self.possible and number in self.sure


class _Ambiguous(Exception):
    """The expression has no meaning in the scene, for example because a definite landmark fits several objects."""


class Verifier:
    """Evaluates expressions in one scene; keeps measured gaps.

    Args:
        graph: scene graph.
    """

    def __init__(self, graph: SceneGraph) -> None:
        self.graph = graph
        self._prints = Footprints(graph)
        self._relations = ObjectRelations(graph, self._prints)
        self._fitting: dict[tuple[str, str | None, str | None], dict[int, Truth]] = {}

    def check(self, sentence: str, language: Reader, view: SceneView | None, number: int) -> str:
        """Returns why a sentence does not fit its target; empty if it does.

        A definite expression must fit the target and no other object. An indefinite expression must fit the target and
        may fit other objects, without borderline cases. Every reading of the sentence must fit.

        Args:
            sentence: the instruction.
            language: reader of its language.
            view: view at the start; `None` if it is unknown, so expressions with a relation to it are rejected.
            number: number of the target in the scene graph.
        """
        readings = language.read(sentence)
        if not readings:
            return "the sentence does not match the grammar"
        return next(filter(None, (self._fault(reading, view, number) for reading in readings)), "")

    def is_false_premise(self, sentence: str, language: Reader, view: SceneView | None) -> bool:
        """Returns whether every reading of a sentence names an object that does not exist in the scene."""
        verdicts = [self.evaluate(reading.expression, view) for reading in language.read(sentence)]
        return bool(verdicts) and not any(verdict.possible or verdict.fault for verdict in verdicts)

    def _fault(self, reading: Reading, view: SceneView | None, number: int) -> str:
        verdict = self.evaluate(reading.expression, view)
        if verdict.fault:
            return verdict.fault
        if number not in verdict.possible:
            return "it does not fit the target"
        if number not in verdict.sure:
            return "the target is a borderline case"
        if reading.expression.definite:
            return "" if verdict.fits_only(number) else f"it fits {len(verdict.possible)} objects"
        return "" if verdict.fits_any(number) else "it fits borderline cases"

    def evaluate(self, expression: Expression, view: SceneView | None) -> FittingObjects:
        """Returns the objects that an expression fits; see `check` for the arguments."""
        if view is None and _needs_view(expression):
            return FittingObjects(frozenset(), frozenset(), "it needs a view, and none is known")
        plain = [clause for clause in expression.clauses if clause.relation not in SUPERLATIVES]
        try:
            truths = self._described(expression.kind, expression.colour, expression.material)
            for clause in plain:
                truths = self._restricted(truths, clause, view)
            truths = self._selected(truths, expression, view)
        except _Ambiguous as error:
            return FittingObjects(frozenset(), frozenset(), str(error))
        sure = frozenset(number for number, truth in truths.items() if truth is Truth.YES)
        return FittingObjects(sure, frozenset(truths))

    def _described(self, kind: str, colour: str | None, material: str | None = None) -> dict[int, Truth]:
        """Returns the objects that a kind, a colour and a material fit, surely or possibly."""
        key = kind, colour, material
        if key in self._fitting:
            return self._fitting[key]
        table = self.graph.kinds
        truths: dict[int, Truth] = {}
        inside, alike = table.kinds_of(kind), table.borderline_of(kind)
        for number, each in enumerate(self.graph.objects):
            truth = Truth.YES if each.kind in inside else Truth.MAYBE if each.kind in alike else Truth.NO
            if each.looks is not None and (each.kind in inside) != (each.looks in inside):
                truth = Truth.MAYBE
            if truth is Truth.NO and inside & set(each.shows):
                truth = Truth.MAYBE
            if colour is not None and each.colour != colour:
                truth = min(truth, Truth.MAYBE if may_be_called(each.colour, colour) else Truth.NO)
            if material is not None:
                truth = min(truth, _is_made_of(each.materials, material))
            if truth is not Truth.NO:
                truths[number] = truth
        self._fitting[key] = truths
        return truths

    def _landmarks(self, landmark: Landmark) -> dict[int, Truth]:
        landmarks = self._described(landmark.kind, landmark.colour)
        if landmark.definite and len(landmarks) > 1:
            raise _Ambiguous(f"the landmark {landmark.kind} is not unique")
        return landmarks

    def _restricted(self, truths: Mapping[int, Truth], clause: Clause, view: SceneView | None) -> dict[int, Truth]:
        landmarks = [self._landmarks(landmark) for landmark in clause.landmarks]
        restricted: dict[int, Truth] = {}
        for number, truth in truths.items():
            holds = min(truth, self._holds(clause, number, landmarks, view))
            if holds is not Truth.NO:
                restricted[number] = holds
        return restricted

    def _holds(self, clause: Clause, number: int, landmarks: list[dict[int, Truth]], view: SceneView | None) -> Truth:
        """Returns whether a relation holds between an object and any of its landmarks."""
        if not landmarks:
            return self._alone(clause, number, view)
        if clause.count is not None:
            return self._counts(clause.relation, number, landmarks[0], clause.count)
        if clause.relation is Relation.BETWEEN:
            pairs = ((first, second) for first in landmarks[0] for second in landmarks[1])
            return max(
                (
                    min(landmarks[0][first], landmarks[1][second], self._relations.is_between(number, first, second))
                    for first, second in pairs
                    if len({first, second, number}) == 3
                ),
                default=Truth.NO,
            )
        best = Truth.NO
        for other, truth in landmarks[0].items():
            if other != number and best is not Truth.YES:
                best = max(best, min(truth, self._relations.holds(clause.relation, number, other, view)))
        return best

    def _alone(self, clause: Clause, number: int, view: SceneView | None) -> Truth:
        each = self.graph.objects[number]
        match clause.relation:
            case Relation.ON_WALL:
                hung = min(at_most(each.wall_gap_m, limit.TOUCH_M), at_least(each.base_m, limit.WALL_BASE_M))
                return Truth.MAYBE if hung is Truth.YES and self._prints.is_supported(number) else hung
            case Relation.IN_CORNER:
                return at_most(each.corner_gap_m, limit.CORNER_M)
            case Relation.EMPTY | Relation.OCCUPIED:
                return self._prints.carries(number, something=clause.relation is Relation.OCCUPIED)
            case Relation.IN_ROOM:
                assert clause.room is not None
                room = self._unique_room(clause.room)
                return self._relations.is_in_parts(number, room, self.graph.areas_of_type(room, clause.room))
            case Relation.THIS_ROOM:
                assert view is not None
                if not view.room or not view.area:
                    raise _Ambiguous("the room of the start is not known")
                return self._relations.is_in_parts(number, view.room, {view.area})
            case _:
                assert view is not None
                return self._relations.from_viewer(clause.relation, number, view)

    def _unique_room(self, kind: str) -> int:
        labels = [
            room.label for room, room_type in zip(self.graph.rooms, self.graph.types, strict=True) if room_type == kind
        ]
        if len(labels) > 1:
            raise _Ambiguous(f"the scene has {len(labels)} rooms of the type {kind}")
        return labels[0] if labels else -1

    def _counts(self, relation: Relation, number: int, things: Mapping[int, Truth], count: int) -> Truth:
        """Returns whether exactly `count` things are beside or on an object."""
        near = self._relations.is_beside if relation is Relation.WITH_BESIDE else self._prints.holds
        truths = [min(truth, near(number, thing)) for thing, truth in things.items() if thing != number]
        sure, possible = truths.count(Truth.YES), len(truths) - truths.count(Truth.NO)
        if sure <= count <= possible:
            return Truth.YES if sure == possible else Truth.MAYBE
        return Truth.NO

    def _selected(self, truths: dict[int, Truth], expression: Expression, view: SceneView | None) -> dict[int, Truth]:
        """Returns the objects that a superlative or an ordinal selects; all objects if the expression has neither.

        A superlative presupposes that there surely are several objects.
        """
        if expression.selectors and sum(truth is Truth.YES for truth in truths.values()) < 2:
            return dict.fromkeys(truths, Truth.MAYBE)
        if expression.ordinal is not None:
            assert view is not None
            place, side = expression.ordinal.number, expression.ordinal.side
            if side in AHEAD_SIDES:
                here = {
                    number: min(truth, self._relations.is_in_room(number, view.room))
                    for number, truth in truths.items()
                }
                return counted_ahead(here, place, side=side, view=view, prints=self._prints)
            return counted(truths, place, side, view)
        if expression.size is not None:
            return by_size(truths, expression.size, self._prints)
        clause = next((clause for clause in expression.clauses if clause.relation in SUPERLATIVES), None)
        if clause is None:
            return truths
        if clause.relation is Relation.NEAREST_YOU:
            assert view is not None
            known = {number: truth if view.sure[number] else Truth.MAYBE for number, truth in truths.items()}
            return extreme(known, self._prints.ranges_from((view.x, view.y), truths), Selected.LEAST)
        (others,) = (self._landmarks(landmark) for landmark in clause.landmarks)
        other = next(iter(others), None)
        if other is None:
            return {}
        gaps = {number: self._prints.gap(number, other) for number in truths if number != other}
        way = Selected.LEAST if clause.relation is Relation.NEAREST_TO else Selected.MOST
        known = {number: min(truths[number], self._relations.is_near_enough(number, other, way)) for number in gaps}
        return extreme(known, gaps, way)


def _is_made_of(materials: tuple[str, ...], material: str) -> Truth:
    """Returns whether a material covers most of an object with these known materials."""
    if materials[:1] == (material,):
        return Truth.YES
    return Truth.MAYBE if not materials or UNKNOWN in materials or material in materials else Truth.NO


def _needs_view(expression: Expression) -> bool:
    relations = {clause.relation for clause in expression.clauses}
    return expression.ordinal is not None or bool(relations & _OF_VIEW)


_OF_VIEW = {
    *(
        Relation.LEFT_OF,
        Relation.RIGHT_OF,
        Relation.IN_FRONT_OF,
        Relation.BEHIND,
        Relation.YOUR_LEFT,
        Relation.YOUR_RIGHT,
    ),
    *(Relation.AHEAD, Relation.THIS_ROOM, Relation.NEAREST_YOU),
}
