"""Finds the parts of expressions that surely hold for one target: kinds, colours, relations and superlatives.

Does not combine the parts.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator
from dataclasses import dataclass
from functools import cached_property
from types import MappingProxyType
from typing import NamedTuple

import numpy as np

from schemas.language import thresholds as limit
from schemas.language.expression import (
    AHEAD_SIDES,
    FAMILY,
    OF_START,
    OF_VIEWER,
    Clause,
    Expression,
    Family,
    Ordinal,
    Relation,
    Size,
    ViewSide,
)
from schemas.language.generator.facts import SceneFacts
from schemas.language.generator.masks import Masks
from schemas.language.generator.parts import ExpressionPart, SceneParts, is_least, part_of
from schemas.language.generator.view_facts import ViewFacts
from schemas.language.graph.view import SceneView
from schemas.language.kinds import UNKNOWN
from schemas.language.sentence.grammar import Grammar


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


class ExpressionCandidate(NamedTuple):
    """Parts of an expression. `expression` builds its model only on demand, because most candidates are not drawn."""

    head: ExpressionHead
    parts: tuple[ExpressionPart, ...] = ()
    size: Size | None = None
    ordinal: Ordinal | None = None
    superlative: Clause | None = None
    """Clause with the relation `nearest_to`, `farthest_from` or `nearest_you`."""

    @property
    def selector(self) -> tuple[Size | None, Ordinal | None, Clause | None]:
        """Size, ordinal and superlative clause, of which at most one is not `None`."""
        return self.size, self.ordinal, self.superlative

    def families(self, kind: str) -> frozenset[Family]:
        named = {
            Family.COLOUR: self.head.colour,
            Family.MATERIAL: self.head.material,
            Family.SIZE: self.size,
            Family.ORDINAL: self.ordinal,
            Family.NEAREST: self.superlative,
            Family.SUPERCLASS: None if self.head.kind == kind else kind,
        }
        families = {family for family, value in named.items() if value is not None}
        return frozenset(families | {FAMILY[part.clause.relation] for part in self.parts})

    def expression(self, definite: bool = True) -> Expression:
        clauses = tuple(part.clause for part in self.parts)
        return Expression(
            kind=self.head.kind,
            definite=definite,
            colour=self.head.colour,
            material=self.head.material,
            size=self.size,
            ordinal=self.ordinal,
            clauses=clauses if self.superlative is None else (*clauses, self.superlative),
        )


_ORDINALS = MappingProxyType(
    {(number, side): Ordinal(number=number, side=side) for number in range(1, 5) for side in ViewSide}
)
_NEAREST_YOU = Clause(relation=Relation.NEAREST_YOU)
_WITHOUT_LANDMARK = MappingProxyType(
    {relation: Clause(relation=relation) for relation in (*sorted(OF_VIEWER), Relation.THIS_ROOM)}
)


@dataclass(frozen=True)
class Search:
    """Parts of expressions for one target.

    Args:
        scene: parts that do not depend on the start.
        view: relations to the start pose; `None` if the start pose is unknown.
        number: number of the target in the scene graph.
        families: features that may be used.
        words: grammar of the language, which limits what can be named.
    """

    scene: SceneParts
    view: ViewFacts | None
    number: int
    families: Collection[Family]
    words: Grammar

    @property
    def facts(self) -> SceneFacts:
        return self.scene.facts

    @property
    def _has_colours(self) -> bool:
        return Family.COLOUR in self.families

    def heads(self) -> list[ExpressionHead]:
        """Returns the kind of the target and its superclasses: each alone, and with the target's colour or material.
        `families` limits the choice."""
        each, table = self.facts.graph.objects[self.number], self.facts.graph.kinds
        kinds = [(each.kind, False)]
        if Family.SUPERCLASS in self.families:
            kinds += [(name, True) for name in table.superclasses_of(each.kind)]
        looks: list[tuple[str | None, str | None]] = [(None, None)]
        if self._has_colours and each.colour != UNKNOWN and table.of(each.kind).plain:
            looks.append((each.colour, None))
        if Family.MATERIAL in self.families and each.materials[:1] and each.materials[0] in self.words.materials:
            looks.append((None, each.materials[0]))
        return [
            ExpressionHead(
                kind, colour, masks=self.facts.described(kind, colour, material), is_super=is_super, material=material
            )
            for kind, is_super in kinds
            if self.words.names(kind)
            for colour, material in looks
        ]

    def parts(self) -> list[ExpressionPart]:
        """Returns the relations that surely hold for the target, without superlatives."""
        kept = self.scene.of(self.number, self.words, self._has_colours)
        return [
            *(part for part in kept if FAMILY[part.clause.relation] in self.families),
            *self._of_viewer(),
            *self._this_room(),
            *self._as_seen(),
        ]

    def _of_viewer(self) -> Iterator[ExpressionPart]:
        if self.view is not None and Family.EGO in self.families:
            for relation, masks in self.view.ego.items():
                if masks.sure[self.number]:
                    yield part_of(_WITHOUT_LANDMARK[relation], masks)

    def _this_room(self) -> Iterator[ExpressionPart]:
        graph = self.facts.graph
        room = graph.objects[self.number].room
        if self.view is None or not room or Family.ROOM not in self.families or len(graph.rooms) < 2:
            return
        seen = self.view.view
        if seen.room == room and seen.area:
            masks = self.facts.in_room(room, seen.area)
            if masks.sure[self.number]:
                yield part_of(_WITHOUT_LANDMARK[Relation.THIS_ROOM], masks)

    def _as_seen(self) -> Iterator[ExpressionPart]:
        if self.view is None or Family.VIEW not in self.families:
            return
        for relation, masks in self.view.relative.items():
            near = np.flatnonzero(masks.sure[:, self.number]).tolist()
            for each in self.scene.descriptions(self.number, self.words, self._has_colours, near):
                members = masks.of_any(each)
                if members.sure[self.number]:
                    yield part_of(Clause(relation=relation, landmarks=(each.landmark,)), members)

    def selectors(self, head: ExpressionHead, parts: tuple[ExpressionPart, ...] = ()) -> list[ExpressionCandidate]:
        """Returns the expressions in which a superlative or an ordinal selects the target among the objects that the
        head and the parts fit."""
        key = head.kind, head.colour, head.material, tuple(part.clause for part in parts)
        if key not in self._selected:
            among = head.masks
            for part in parts:
                among = among.both(part.masks)
            self._selected[key] = list(self._selectors(ExpressionCandidate(head, parts), key, among))
        return self._selected[key]

    @cached_property
    def _selected(self) -> dict[object, list[ExpressionCandidate]]:
        return {}

    def _selectors(self, base: ExpressionCandidate, key: object, among: Masks) -> Iterator[ExpressionCandidate]:
        if not among.sure[self.number] or int(np.count_nonzero(among.sure)) < 2:
            return
        others = np.flatnonzero(among.possible)
        others = others[others != self.number]
        is_kept = all(part.clause.relation not in OF_START for part in base.parts)
        selectors = self.scene.superlatives(
            self.number, self.words, self._has_colours, key if is_kept else None, others.tolist()
        )
        if Family.SIZE in self.families:
            yield from (base._replace(size=size) for size in selectors.sizes)
        if Family.NEAREST in self.families:
            if self._is_nearest(others.tolist()):
                yield base._replace(superlative=_NEAREST_YOU)
            yield from (base._replace(superlative=clause) for clause in selectors.nearest)
        if Family.ORDINAL in self.families and self.view is not None:
            yield from (base._replace(ordinal=ordinal) for ordinal in self._ordinals(among))

    def _is_nearest(self, others: list[int]) -> bool:
        seen = self.view
        return seen is not None and bool(seen.view.sure[self.number]) and is_least(seen.distance, self.number, others)

    def _ordinals(self, among: Masks) -> Iterator[Ordinal]:
        assert self.view is not None
        yield from self._across(among, self.view.view)
        for side in AHEAD_SIDES:
            row = self.view.row(among, side, self.number)[:4]
            if self.number in row:
                yield _ORDINALS[row.index(self.number) + 1, side]

    def _across(self, among: Masks, view: SceneView) -> Iterator[Ordinal]:
        seen = np.flatnonzero(among.possible & view.possible)
        if self.number not in seen or int(np.count_nonzero(among.sure & view.sure)) < 2:
            return
        for side, sign in ((ViewSide.LEFT, -1.0), (ViewSide.RIGHT, 1.0)):
            order = seen[np.argsort(sign * view.bearing[seen], kind="stable")]
            place = int(np.flatnonzero(order == self.number)[0])
            first, around = order[: place + 1], order[: place + 2]
            is_sure = (among.sure[first] & view.sure[first]).all()
            is_apart = (np.abs(np.diff(view.bearing[around])) >= limit.BEARING_GAP_RAD).all()
            if place < 4 and is_sure and is_apart:
                yield _ORDINALS[place + 1, side]
