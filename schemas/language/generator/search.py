"""Finds the parts of expressions that surely hold for one target: kinds, colours, relations and superlatives.

Does not combine the parts.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import combinations
from typing import NamedTuple

import numpy as np

from schemas.language import thresholds as limit
from schemas.language.expression import (
    COUNTED,
    FAMILY,
    Clause,
    Expression,
    Family,
    Landmark,
    Ordinal,
    Relation,
    Size,
    ViewSide,
)
from schemas.language.generator.facts import Described, Masks, SceneFacts, ViewFacts
from schemas.language.grammar import Grammar
from schemas.language.kinds import UNKNOWN
from schemas.support.numpy_types import Floats

_NEARBY_M = 6.0
_COUNTS = range(2, 7)
"""Numbers of objects that are named."""


class ExpressionPart(NamedTuple):
    """Relation that surely holds for the target."""

    clause: Clause
    masks: Masks


class ExpressionHead(NamedTuple):
    """Kind, perhaps with a colour or a material."""

    kind: str
    colour: str | None
    masks: Masks
    is_super: bool
    material: str | None = None

    @property
    def is_bare(self) -> bool:
        """Whether it names neither colour nor material."""
        return self.colour is None and self.material is None


@dataclass(frozen=True)
class Search:
    """Parts of expressions for one target.

    Args:
        facts: relations of the scene.
        view: relations from the start; `None` if none is known.
        number: number of the target in the scene graph.
        families: features that may be used.
        words: grammar of the language, which limits what can be named.
    """

    facts: SceneFacts
    view: ViewFacts | None
    number: int
    families: Collection[Family]
    words: Grammar

    @property
    def nouns(self) -> Collection[str]:
        """Kinds that the language can name."""
        return self.words.nouns

    @property
    def rooms(self) -> Collection[str]:
        """Types of rooms that the language can name."""
        return self.words.rooms

    def heads(self) -> list[ExpressionHead]:
        """Returns the kinds that fit the target: alone, with its colour, and with its material."""
        each, table = self.facts.graph.objects[self.number], self.facts.graph.kinds
        kinds = [(each.kind, False)]
        if Family.SUPERCLASS in self.families:
            kinds += [(name, True) for name in table.superclasses_of(each.kind)]
        looks: list[tuple[str | None, str | None]] = [(None, None)]
        if Family.COLOUR in self.families and each.colour != UNKNOWN and table.of(each.kind).plain:
            looks.append((each.colour, None))
        if Family.MATERIAL in self.families and each.materials[:1] and each.materials[0] in self.words.materials:
            looks.append((None, each.materials[0]))
        return [
            ExpressionHead(kind, colour, self.facts.described(kind, colour, material), is_super, material)
            for kind, is_super in kinds
            if kind in self.nouns
            for colour, material in looks
        ]

    def parts(self) -> list[ExpressionPart]:
        """Returns the relations that surely hold for the target, without superlatives."""
        found = [*self._alone(), *self._rooms(), *self._counts()]
        for relation, masks in self._pairs():
            found += self._to_landmarks(relation, masks)
        if Family.BETWEEN in self.families:
            found += self._between()
        return found

    def _alone(self) -> Iterator[ExpressionPart]:
        groups = [self.facts.alone, self.view.ego if self.view is not None else {}]
        for relation, masks in (item for group in groups for item in group.items()):
            if FAMILY[relation] in self.families and masks.sure[self.number]:
                yield ExpressionPart(Clause(relation=relation), masks)

    def _counts(self) -> Iterator[ExpressionPart]:
        is_surface = self.facts.graph.kinds.of(self.facts.graph.objects[self.number].kind).surface
        if Family.COUNT not in self.families or not is_surface:
            return
        for relation in sorted(COUNTED):
            for kind in self.words.plurals:
                for count in _COUNTS:
                    masks = self.facts.counted(relation, kind, count)
                    if masks.sure[self.number]:
                        landmark = Landmark(kind=kind, definite=False)
                        yield ExpressionPart(Clause(relation=relation, landmarks=(landmark,), count=count), masks)

    def _rooms(self) -> Iterator[ExpressionPart]:
        graph = self.facts.graph
        room = graph.objects[self.number].room
        if Family.ROOM not in self.families or not room:
            return
        if self.view is not None and self.view.view.room == room and self.view.view.area and len(graph.rooms) > 1:
            masks = self.facts.in_room(room, self.view.view.area)
            if masks.sure[self.number]:
                yield ExpressionPart(Clause(relation=Relation.THIS_ROOM), masks)
        kind = graph.types[room - 1]
        if kind in self.rooms and graph.unique_room(str(kind)) == room:
            masks = self.facts.in_typed_room(room)
            if masks.sure[self.number]:
                yield ExpressionPart(Clause(relation=Relation.IN_ROOM, room=kind), masks)
        if len(graph.rooms) > 1:
            pairs = self.facts.same_room
            for each in self._descriptions(np.flatnonzero(pairs.sure[self.number]).tolist()):
                if each.landmark.definite and each.landmark.colour is None:
                    clause = Clause(relation=Relation.SAME_ROOM, landmarks=(each.landmark,))
                    yield ExpressionPart(clause, pairs.of_any(each))

    def _pairs(self) -> Iterator[tuple[Relation, Masks]]:
        pairs = {Relation.NEXT_TO: self.facts.next_to, **self.facts.support}
        if self.view is not None and Family.VIEW in self.families:
            pairs |= self.view.relative
        return ((relation, masks) for relation, masks in pairs.items() if FAMILY[relation] in self.families)

    def _descriptions(self, numbers: Sequence[int]) -> list[Described]:
        """Returns short descriptions of objects other than those of the target's kind."""
        graph, own = self.facts.graph, self.facts.graph.objects[self.number].kind
        most = 2 if Family.COLOUR in self.families else 1
        found: dict[Landmark, Described] = {}
        for number in numbers:
            kind = graph.objects[number].kind
            if kind != own and kind in self.nouns:
                found |= {each.landmark: each for each in self.facts.landmarks[number][:most]}
        return list(found.values())

    def _to_landmarks(self, relation: Relation, masks: Masks) -> Iterator[ExpressionPart]:
        near = np.flatnonzero(masks.sure[:, self.number]).tolist()
        for each in self._descriptions(near):
            found = masks.of_any(each)
            if found.sure[self.number]:
                yield ExpressionPart(Clause(relation=relation, landmarks=(each.landmark,)), found)

    def _between(self) -> Iterator[ExpressionPart]:
        facts, room = self.facts, self.facts.graph.objects[self.number].room
        near = np.flatnonzero(
            (facts.gap[self.number] < limit.BETWEEN_SPAN_M.good / 1.5) & (facts.graph.room_of == room)
        )
        landmarks = [each for each in self._descriptions(near.tolist()) if each.landmark.definite]
        for one, two in combinations(landmarks, 2):
            first, second = int(one.sure[0]), int(two.sure[0])
            if first != second and facts.is_between(self.number, first, second):
                clause = Clause(relation=Relation.BETWEEN, landmarks=(one.landmark, two.landmark))
                yield ExpressionPart(clause, facts.between(first, second))

    def selectors(self, head: ExpressionHead, parts: tuple[ExpressionPart, ...] = ()) -> list[Expression]:
        """Returns the expressions in which a superlative or an ordinal selects the target among the fitting objects."""
        key = head.kind, head.colour, head.material, tuple(part.clause for part in parts)
        if key not in self._selected:
            among = head.masks
            for part in parts:
                among = among.both(part.masks)
            self._selected[key] = list(self._selectors(head, parts, among))
        return self._selected[key]

    @cached_property
    def _selected(self) -> dict[object, list[Expression]]:
        return {}

    def _selectors(self, head: ExpressionHead, parts: Sequence[ExpressionPart], among: Masks) -> Iterator[Expression]:
        base = expression_of(head, parts)
        if not among.sure[self.number] or int(among.sure.sum()) < 2:
            return
        others = np.flatnonzero(among.possible)
        others = others[others != self.number]
        if Family.SIZE in self.families:
            yield from (base.model_copy(update={"size": size}) for size in self._sizes(others.tolist()))
        if Family.NEAREST in self.families:
            for clause in self._nearest(others.tolist()):
                yield base.model_copy(update={"clauses": (*base.clauses, clause)})
        if Family.ORDINAL in self.families and self.view is not None:
            yield from (base.model_copy(update={"ordinal": ordinal}) for ordinal in self._ordinals(among))

    def _sizes(self, others: list[int]) -> Iterator[Size]:
        for values, ratio, most, least in (
            (self.facts.volume, limit.VOLUME_RATIO, Size.LARGEST, Size.SMALLEST),
            (self.facts.height, limit.HEIGHT_RATIO, Size.TALLEST, Size.LOWEST),
        ):
            own, rest = values[self.number], values[others]
            if most is Size.TALLEST and not self.facts.has_same_base[self.number, others].all():
                continue
            if own >= ratio * rest.max():
                yield most
            if own * ratio <= rest.min():
                yield least

    def _nearest(self, others: list[int]) -> Iterator[Clause]:
        facts, graph = self.facts, self.facts.graph
        seen = self.view
        if seen is not None and seen.view.sure[self.number] and _is_least(seen.distance, self.number, others):
            yield Clause(relation=Relation.NEAREST_YOU)
        room = graph.objects[self.number].room
        for each in self._definite_nearby if room else ():
            gaps = facts.gap[each.sure[0]]
            rest = [number for number in others if number != each.sure[0]]
            if rest and _is_least(gaps, self.number, rest):
                yield Clause(relation=Relation.NEAREST_TO, landmarks=(each.landmark,))
            if rest and _is_least(-gaps, self.number, rest):
                yield Clause(relation=Relation.FARTHEST_FROM, landmarks=(each.landmark,))

    @cached_property
    def _definite_nearby(self) -> list[Described]:
        """Landmarks that are unique in the scene, in the target's room."""
        room = self.facts.graph.room_of
        near = np.flatnonzero((room == room[self.number]) & (self.facts.gap[self.number] < _NEARBY_M))
        return [each for each in self._descriptions(near.tolist()) if each.landmark.definite]

    def _ordinals(self, among: Masks) -> Iterator[Ordinal]:
        assert self.view is not None
        view = self.view.view
        seen = np.flatnonzero(among.possible & view.possible)
        if self.number not in seen or int((among.sure & view.sure).sum()) < 2:
            return
        for side, sign in ((ViewSide.LEFT, -1.0), (ViewSide.RIGHT, 1.0)):
            order = seen[np.argsort(sign * view.bearing[seen], kind="stable")]
            place = int(np.flatnonzero(order == self.number)[0])
            first, around = order[: place + 1], order[: place + 2]
            is_sure = (among.sure[first] & view.sure[first]).all()
            is_apart = (np.abs(np.diff(view.bearing[around])) >= limit.BEARING_GAP_RAD).all()
            if place < 4 and is_sure and is_apart:
                yield Ordinal(number=place + 1, side=side)


def _is_least(values: Floats, number: int, others: list[int]) -> bool:
    """Returns whether a value is clearly the smallest; negative values are distances of which the largest is meant."""
    own, rest = float(values[number]), float(values[others].min())
    if own >= 0:
        return rest >= max(own * limit.DISTANCE_RATIO, own + limit.DISTANCE_GAP_M)
    return -own >= max(-rest * limit.DISTANCE_RATIO, -rest + limit.DISTANCE_GAP_M)


def expression_of(head: ExpressionHead, parts: Sequence[ExpressionPart], definite: bool = True) -> Expression:
    """Returns the expression of a head and relations."""
    clauses = tuple(part.clause for part in parts)
    return Expression(kind=head.kind, colour=head.colour, material=head.material, clauses=clauses, definite=definite)
