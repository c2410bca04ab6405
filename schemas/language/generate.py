"""Finds expressions that fit exactly one object, or any of a set, with no part that can be dropped.

Enumerates parts that surely hold for the target and keeps combinations that exclude every other object, as in the full-brevity
algorithm (Dale & Reiter 1995). Writes no words; `verify` checks the sentences.
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
    FAMILY,
    SUPERLATIVES,
    Clause,
    Expression,
    Family,
    Landmark,
    Ordinal,
    Relation,
    Side,
    Size,
)
from schemas.language.facts import Described, Masks, SceneFacts, ViewFacts
from schemas.language.graph import UNKNOWN
from schemas.support.numpy_types import Floats

_WITH_ORDINAL = frozenset({Family.ROOM})
"""Families of relations that are combined with an ordinal: "the second chair from the left next to a table" is ambiguous."""
_NEARBY_M = 6.0
_MOST_SELECTED = 4
"""Number of relations that are combined with a superlative."""
_MOST_PARTS = 24
"""Number of relations that are combined in pairs; more are drawn at random."""


class Part(NamedTuple):
    """Relation that surely holds for the target."""

    clause: Clause
    masks: Masks


class Head(NamedTuple):
    """Kind, perhaps with a colour."""

    kind: str
    colour: str | None
    masks: Masks
    is_super: bool


@dataclass(frozen=True)
class Search:
    """Parts of expressions for one target.

    Args:
        facts: relations of the scene.
        view: relations from the start; `None` if none is known.
        number: number of the target in the scene graph.
        families: features that may be used.
        nouns: kinds that the language can name.
        rooms: types of rooms that the language can name.
    """

    facts: SceneFacts
    view: ViewFacts | None
    number: int
    families: Collection[Family]
    nouns: Collection[str]
    rooms: Collection[str]

    def heads(self) -> list[Head]:
        """Returns the kinds and colours that fit the target."""
        each, table = self.facts.graph.objects[self.number], self.facts.graph.kinds
        kinds = [(each.kind, False)]
        if Family.SUPERCLASS in self.families:
            kinds += [(name, True) for name in table.superclasses_of(each.kind)]
        colours: list[str | None] = [None]
        if Family.COLOUR in self.families and each.colour != UNKNOWN and table.of(each.kind).plain:
            colours.append(each.colour)
        return [
            Head(kind, colour, self.facts.described(kind, colour), is_super)
            for kind, is_super in kinds
            if kind in self.nouns
            for colour in colours
        ]

    def parts(self) -> list[Part]:
        """Returns the relations that surely hold for the target, without superlatives."""
        found = [*self._alone(), *self._rooms()]
        for relation, masks in self._pairs():
            found += self._to_landmarks(relation, masks)
        if Family.BETWEEN in self.families:
            found += self._between()
        return found

    def _alone(self) -> Iterator[Part]:
        groups = [self.facts.alone, self.view.ego if self.view is not None else {}]
        for relation, masks in (item for group in groups for item in group.items()):
            if FAMILY[relation] in self.families and masks.sure[self.number]:
                yield Part(Clause(relation=relation), masks)

    def _rooms(self) -> Iterator[Part]:
        graph = self.facts.graph
        room = graph.objects[self.number].room
        if Family.ROOM not in self.families or not room:
            return
        masks = self.facts.in_room(room)
        if self.view is not None and self.view.view.room == room and len(graph.rooms) > 1:
            yield Part(Clause(relation=Relation.THIS_ROOM), masks)
        kind = graph.types[room - 1]
        if kind in self.rooms and graph.the_room(str(kind)) == room:
            yield Part(Clause(relation=Relation.IN_ROOM, room=kind), masks)
        if len(graph.rooms) > 1:
            for each in self._descriptions(np.flatnonzero(masks.sure).tolist()):
                if each.landmark.definite and each.landmark.colour is None:
                    yield Part(Clause(relation=Relation.SAME_ROOM, landmarks=(each.landmark,)), masks)

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

    def _to_landmarks(self, relation: Relation, masks: Masks) -> Iterator[Part]:
        near = np.flatnonzero(masks.sure[:, self.number]).tolist()
        for each in self._descriptions(near):
            sure, possible = masks.sure[each.sure].any(axis=0), masks.possible[each.possible].any(axis=0)
            if sure[self.number]:
                yield Part(Clause(relation=relation, landmarks=(each.landmark,)), Masks(sure, possible))

    def _between(self) -> Iterator[Part]:
        facts, room = self.facts, self.facts.graph.objects[self.number].room
        near = np.flatnonzero(
            (facts.gap[self.number] < limit.BETWEEN_SPAN_M.good / 1.5) & (facts.graph.room_of == room)
        )
        landmarks = [each for each in self._descriptions(near.tolist()) if each.landmark.definite]
        for one, two in combinations(landmarks, 2):
            first, second = int(one.sure[0]), int(two.sure[0])
            if first != second and facts.is_between(self.number, first, second):
                clause = Clause(relation=Relation.BETWEEN, landmarks=(one.landmark, two.landmark))
                yield Part(clause, facts.between(first, second))

    def selectors(self, head: Head, parts: tuple[Part, ...] = ()) -> list[Expression]:
        """Returns the expressions in which a superlative or an ordinal selects the target among the fitting objects."""
        key = head.kind, head.colour, tuple(part.clause for part in parts)
        if key not in self._selected:
            among = head.masks
            for part in parts:
                among = among.both(part.masks)
            self._selected[key] = list(self._selectors(head, parts, among))
        return self._selected[key]

    @cached_property
    def _selected(self) -> dict[object, list[Expression]]:
        return {}

    def _selectors(self, head: Head, parts: Sequence[Part], among: Masks) -> Iterator[Expression]:
        base = _expression(head, parts)
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
            if own >= ratio * rest.max():
                yield most
            if own * ratio <= rest.min():
                yield least

    def _nearest(self, others: list[int]) -> Iterator[Clause]:
        facts, graph = self.facts, self.facts.graph
        if self.view is not None and self.view.view.sure[self.number]:
            if _is_least(self.view.distance, self.number, others):
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
        for side, sign in ((Side.LEFT, -1.0), (Side.RIGHT, 1.0)):
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


def _expression(head: Head, parts: Sequence[Part], definite: bool = True) -> Expression:
    clauses = tuple(part.clause for part in parts)
    return Expression(kind=head.kind, colour=head.colour, clauses=clauses, definite=definite)


def _bits(masks: Masks) -> int:
    """Returns the possible objects as the bits of an integer."""
    return int.from_bytes(np.packbits(masks.possible, bitorder="little").tobytes(), "little")


def minimal_expressions(search: Search, rng: np.random.Generator) -> list[Expression]:
    """Returns definite expressions that fit the target only, and from which no part can be dropped.

    Args:
        search: parts of expressions for the target.
        rng: random generator that draws the relations to combine if there are many.
    """
    parts = search.parts()
    parts = [parts[number] for number in rng.permutation(len(parts))[:_MOST_PARTS].tolist()]
    own = 1 << search.number
    bits = [_bits(part.masks) for part in parts]
    found: list[Expression] = []
    for head in search.heads():
        if head.masks.sure[search.number]:
            bare = _bits(search.facts.described(head.kind, None)) if head.colour is not None else -1
            found += _with_head(search, head, list(zip(parts, bits, strict=True)), own, bare)
    return found


def _with_head(search: Search, head: Head, parts: list[tuple[Part, int]], own: int, bare: int) -> Iterator[Expression]:
    """Yields the minimal expressions with a head.

    Args:
        search: parts of expressions for the target.
        head: kind and colour.
        parts: relations, each with the objects that it possibly fits as bits.
        own: bit of the target.
        bare: objects that the kind without the colour fits, as bits; -1 for a head without colour.
    """
    base = _bits(head.masks)
    if base == own:
        if bare != own:
            yield _expression(head, ())
        return
    plain = head._replace(colour=None, masks=search.facts.described(head.kind, None))
    without = {_selector(one) for one in search.selectors(plain)} if bare >= 0 else set()
    yield from (one for one in search.selectors(head) if _selector(one) not in without and _is_readable(one))
    useful = []
    for part, bits in parts:
        if bare >= 0 and bare & bits == own:
            continue  # the colour can be dropped
        if base & bits == own:
            yield _expression(head, (part,))
        elif base & bits != base:
            useful.append((part, bits))
    for (one, first), (two, second) in combinations(useful, 2):
        if base & first & second == own and not (bare >= 0 and bare & first & second == own):
            yield _expression(head, (one, two))
    if bare < 0:
        for part, _ in useful[:_MOST_SELECTED]:
            yield from _selected(search, head, part)


def _selected(search: Search, head: Head, part: Part) -> Iterator[Expression]:
    """Yields the expressions in which a superlative selects the target among the objects of a relation.

    Without the relation, the same superlative does not select the target.
    """
    without = {_selector(one) for one in search.selectors(head)}
    for one in search.selectors(head, (part,)):
        if _is_readable(one) and _selector(one) not in without:
            yield one


def _is_readable(expression: Expression) -> bool:
    """Returns whether a reader knows among which objects an expression counts, or looks for the farthest one."""
    families = {FAMILY[clause.relation] for clause in expression.clauses}
    if expression.ordinal is not None:
        return families <= _WITH_ORDINAL
    is_farthest = any(clause.relation is Relation.FARTHEST_FROM for clause in expression.clauses)
    return not is_farthest or Family.ROOM in families


def _selector(expression: Expression) -> object:
    """Returns the superlative or ordinal of an expression."""
    chosen = [clause for clause in expression.clauses if clause.relation in SUPERLATIVES]
    return expression.size, expression.ordinal, *chosen


def indefinite_expressions(search: Search) -> list[Expression]:
    """Returns expressions with "a" that fit the target and other objects, without borderline cases."""
    parts = search.parts()
    found = []
    for head in search.heads():
        for chosen in ((), *((part,) for part in parts)):
            masks = head.masks.both(chosen[0].masks) if chosen else head.masks
            if masks.sure[search.number] and masks.sure.sum() > 1 and (masks.sure == masks.possible).all():
                found.append(_expression(head, chosen, definite=False))
    return found


def redundant_expressions(search: Search, expression: Expression) -> list[Expression]:
    """Returns the expression with one more part that surely holds for the target: a colour or a relation."""
    found: list[Expression] = []
    if expression.selectors:
        return found  # another part would change the objects among which it selects
    for head in search.heads():
        if head.kind == expression.kind and head.colour is not None and expression.colour is None:
            found.append(expression.model_copy(update={"colour": head.colour}))
    if len(expression.clauses) < 2:
        named = {clause.relation for clause in expression.clauses}
        for part in search.parts():
            if part.clause.relation not in named:
                found.append(expression.model_copy(update={"clauses": (part.clause, *expression.clauses)}))
    return found
