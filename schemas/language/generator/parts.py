"""Computes the parts of expressions that do not depend on the start pose, once for each target of a scene.

Does not combine the parts.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Sequence
from itertools import combinations
from typing import NamedTuple

import numpy as np

from schemas.language import thresholds as limit
from schemas.language.expression import COUNTED, Clause, Landmark, Relation, Size
from schemas.language.generator.facts import SceneFacts
from schemas.language.generator.masks import Described, Masks
from schemas.language.sentence.grammar import Grammar
from schemas.support.numpy_types import Bools, Floats

_NEARBY_M = 6.0
_COUNTS = range(2, 7)
"""Counts that relations such as `with_on` name."""


class ExpressionPart(NamedTuple):
    """Relation that surely holds for the target."""

    clause: Clause
    masks: Masks
    bits: int
    """Objects for which the relation possibly holds, as a bit mask."""


class Superlatives(NamedTuple):
    """Superlatives that surely select the target among given objects."""

    sizes: tuple[Size, ...]
    nearest: tuple[Clause, ...]
    """Clauses with the relation `nearest_to` or `farthest_from`."""


def part_of(clause: Clause, masks: Masks) -> ExpressionPart:
    """Returns the part of an expression for a clause and the objects for which it holds."""
    return ExpressionPart(clause, masks, bits_of(masks.possible))


def bits_of(possible: Bools) -> int:
    """Returns a mask as an integer; bit n is 1 if the mask includes object n."""
    return int.from_bytes(np.packbits(possible, bitorder="little").tobytes(), "little")


class SceneParts:
    """Parts of expressions for the objects of one scene.

    Args:
        facts: relations of the scene.
    """

    def __init__(self, facts: SceneFacts) -> None:
        self.facts = facts
        self._parts: dict[tuple[int, frozenset[str], bool], tuple[ExpressionPart, ...]] = {}
        self._selected: dict[tuple[int, frozenset[str], bool, object], Superlatives] = {}

    def of(self, number: int, words: Grammar, has_colours: bool) -> tuple[ExpressionPart, ...]:
        """Returns the relations without superlatives that surely hold for an object.

        Args:
            number: number of the object in the scene graph.
            words: grammar of the language, which limits what can be named.
            has_colours: whether landmarks are named by their colour, too.
        """
        key = number, words.kinds, has_colours
        if key not in self._parts:
            self._parts[key] = tuple(_StaticParts(self.facts, number, words, has_colours).all())
        return self._parts[key]

    def superlatives(
        self, number: int, words: Grammar, has_colours: bool, among: object, others: Sequence[int]
    ) -> Superlatives:
        """Returns the superlatives that select an object among others.

        Args:
            number: number of the object in the scene graph.
            words: grammar of the language.
            has_colours: whether landmarks are named by their colour, too.
            among: hashable description of the other objects, used as a key of the cache; `None` if they depend on the
                start, so nothing is cached.
            others: numbers of the other objects, at least one.
        """
        parts = _StaticParts(self.facts, number, words, has_colours)
        if among is None:
            return parts.superlatives(others)
        key = number, words.kinds, has_colours, among
        if key not in self._selected:
            self._selected[key] = parts.superlatives(others)
        return self._selected[key]

    def descriptions(self, number: int, words: Grammar, has_colours: bool, near: Collection[int]) -> list[Described]:
        """Returns short descriptions of the objects `near` whose kind differs from the kind of object `number`."""
        return _StaticParts(self.facts, number, words, has_colours).descriptions(near)


class _StaticParts:
    """Computes the parts for one target."""

    def __init__(self, facts: SceneFacts, number: int, words: Grammar, has_colours: bool) -> None:
        self._facts, self._number, self._words = facts, number, words
        self._most = 2 if has_colours else 1

    def all(self) -> Iterator[ExpressionPart]:
        facts = self._facts
        for relation, masks in facts.alone.items():
            if masks.sure[self._number]:
                yield part_of(Clause(relation=relation), masks)
        yield from self._rooms()
        yield from self._counts()
        for relation, masks in {Relation.NEXT_TO: facts.next_to, **facts.support}.items():
            near = np.flatnonzero(masks.sure[:, self._number]).tolist()
            for each in self.descriptions(near):
                members = masks.of_any(each)
                if members.sure[self._number]:
                    yield part_of(Clause(relation=relation, landmarks=(each.landmark,)), members)
        yield from self._between()

    def _rooms(self) -> Iterator[ExpressionPart]:
        graph, facts = self._facts.graph, self._facts
        room = graph.objects[self._number].room
        if not room:
            return
        kind = graph.types[room - 1]
        if kind in self._words.rooms and graph.unique_room(str(kind)) == room:
            masks = facts.in_typed_room(room)
            if masks.sure[self._number]:
                yield part_of(Clause(relation=Relation.IN_ROOM, room=kind), masks)
        if len(graph.rooms) > 1:
            pairs = facts.same_room
            for each in self.descriptions(np.flatnonzero(pairs.sure[self._number]).tolist()):
                if each.landmark.definite and each.landmark.colour is None:
                    clause = Clause(relation=Relation.SAME_ROOM, landmarks=(each.landmark,))
                    yield part_of(clause, pairs.of_any(each))

    def _counts(self) -> Iterator[ExpressionPart]:
        if not self._facts.graph.kinds.of(self._facts.graph.objects[self._number].kind).surface:
            return
        for relation in sorted(COUNTED):
            for kind in self._words.plurals:
                for count in _COUNTS:
                    masks = self._facts.counted(relation, kind, count)
                    if masks.sure[self._number]:
                        landmark = Landmark(kind=kind, definite=False)
                        yield part_of(Clause(relation=relation, landmarks=(landmark,), count=count), masks)

    def descriptions(self, numbers: Collection[int]) -> list[Described]:
        graph, own_kind = self._facts.graph, self._facts.graph.objects[self._number].kind
        descriptions: dict[Landmark, Described] = {}
        for number in numbers:
            kind = graph.objects[number].kind
            if kind != own_kind and self._words.names(kind):
                descriptions |= {each.landmark: each for each in self._facts.landmarks[number][: self._most]}
        return list(descriptions.values())

    def _between(self) -> Iterator[ExpressionPart]:
        facts, room = self._facts, self._facts.graph.objects[self._number].room
        near = (facts.gap[self._number] < limit.BETWEEN_SPAN_M.good / 1.5) & (facts.graph.room_of == room)
        landmarks = [each for each in self.descriptions(np.flatnonzero(near).tolist()) if each.landmark.definite]
        for one, two in combinations(landmarks, 2):
            first, second = int(one.sure[0]), int(two.sure[0])
            if first != second and facts.is_between(self._number, first, second):
                clause = Clause(relation=Relation.BETWEEN, landmarks=(one.landmark, two.landmark))
                yield part_of(clause, facts.between(first, second))

    def superlatives(self, others: Sequence[int]) -> Superlatives:
        return Superlatives(tuple(self._sizes(others)), tuple(self._nearest(others)))

    def _sizes(self, others: Sequence[int]) -> Iterator[Size]:
        kinds = {self._facts.graph.objects[number].kind for number in (self._number, *others)}
        if not all(self._facts.graph.kinds.of(kind).sized for kind in kinds):
            return
        for values, ratio, most, least in (
            (self._facts.volume, limit.VOLUME_RATIO, Size.LARGEST, Size.SMALLEST),
            (self._facts.height, limit.HEIGHT_RATIO, Size.TALLEST, Size.LOWEST),
        ):
            own_size, rest = values[self._number], values[others]
            if most is Size.TALLEST and not self._facts.has_same_base[self._number, others].all():
                continue
            if own_size >= ratio * rest.max():
                yield most
            if own_size * ratio <= rest.min():
                yield least

    def _nearest(self, others: Sequence[int]) -> Iterator[Clause]:
        facts, room_of = self._facts, self._facts.graph.room_of
        if not room_of[self._number]:
            return
        near = np.flatnonzero(
            (room_of == room_of[self._number])
            & (facts.gap[self._number] < _NEARBY_M)
            & ~facts.graph.walled[self._number]
        )
        for each in self.descriptions(near.tolist()):
            if not each.landmark.definite:
                continue
            gaps = facts.gap[each.sure[0]]
            rest = [number for number in others if number != each.sure[0]]
            if rest and is_least(gaps, self._number, rest):
                yield Clause(relation=Relation.NEAREST_TO, landmarks=(each.landmark,))
            if rest and is_least(-gaps, self._number, rest):
                yield Clause(relation=Relation.FARTHEST_FROM, landmarks=(each.landmark,))


def is_least(values: Floats, number: int, others: Sequence[int]) -> bool:
    """Returns whether an object clearly has the smallest value; with negated values, the largest."""
    own_size, rest = float(values[number]), float(values[others].min())
    if own_size >= 0:
        return rest >= max(own_size * limit.DISTANCE_RATIO, own_size + limit.DISTANCE_GAP_M)
    return -own_size >= max(-rest * limit.DISTANCE_RATIO, -rest + limit.DISTANCE_GAP_M)
