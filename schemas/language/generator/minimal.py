"""Combines parts into expressions that fit one object, or any object of a set, and from which no part can be dropped.

Keeps the combinations that exclude every other object, as the full-brevity algorithm does (Dale & Reiter 1995).
"""

from __future__ import annotations

from collections.abc import Iterator
from itertools import combinations

import numpy as np

from schemas.language.expression import FAMILY, Expression, Family, Relation
from schemas.language.generator.parts import ExpressionPart, bits_of
from schemas.language.generator.search import ExpressionCandidate, ExpressionHead, Search

_WITH_ORDINAL = frozenset({Family.ROOM})
"""Families of relations that are combined with an ordinal. With a relation of another family, it is unclear which
objects "the second chair from the left" counts."""
_MOST_SELECTED = 4
"""Maximum number of relations that are combined with a superlative or an ordinal, one relation at a time."""
_MOST_PARTS = 24
"""Maximum number of relations that are used, alone or in pairs. If more relations hold for the target, this many are
drawn at random."""


def minimal_expressions(search: Search, rng: np.random.Generator) -> list[Expression]:
    """Returns definite expressions that fit the target only, and from which no part can be dropped; see
    `minimal_candidates`."""
    return [each.expression() for each in minimal_candidates(search, rng)]


def minimal_candidates(search: Search, rng: np.random.Generator) -> list[ExpressionCandidate]:
    """Returns candidates for definite expressions that fit the target only, and from which no part can be dropped.

    Args:
        search: parts of expressions for the target.
        rng: random generator that draws the relations to combine if there are many.
    """
    parts = search.parts()
    parts = [parts[number] for number in rng.permutation(len(parts))[:_MOST_PARTS].tolist()]
    own_bit = 1 << search.number
    candidates: list[ExpressionCandidate] = []
    for head in search.heads():
        if head.masks.sure[search.number]:
            bare = -1 if head.is_bare else bits_of(search.facts.described(head.kind, None).possible)
            candidates += _with_head(search, head, parts=parts, target_bit=own_bit, bare=bare)
    return candidates


def _with_head(
    search: Search, head: ExpressionHead, parts: list[ExpressionPart], target_bit: int, bare: int
) -> Iterator[ExpressionCandidate]:
    """Yields the minimal expressions with a given head: a kind, perhaps with a colour or a material.

    Args:
        search: parts of expressions for the target.
        head: kind, perhaps with colour or material.
        parts: relations that surely hold for the target.
        target_bit: the target, as bits of an integer (see `bits_of`).
        bare: objects that the kind alone fits, as bits; -1 for a head without colour and material.
    """
    base = bits_of(head.masks.possible)
    if base == target_bit:
        if bare != target_bit:
            yield ExpressionCandidate(head)
        return
    plain = head._replace(colour=None, material=None, masks=search.facts.described(head.kind, None))
    without = {one.selector for one in search.selectors(plain)} if bare >= 0 else set()
    yield from (one for one in search.selectors(head) if one.selector not in without and _is_readable(one))
    useful = []
    for part in parts:
        if bare >= 0 and bare & part.bits == target_bit:
            continue  # the relation selects the target without the colour or material
        if base & part.bits == target_bit:
            yield ExpressionCandidate(head, (part,))
        elif base & part.bits != base:
            useful.append(part)
    for one, two in combinations(useful, 2):
        both = one.bits & two.bits
        if base & both == target_bit and not (bare >= 0 and bare & both == target_bit):
            yield ExpressionCandidate(head, (one, two))
    if bare < 0:
        for part in useful[:_MOST_SELECTED]:
            yield from _selected(search, head, part)


def _selected(search: Search, head: ExpressionHead, part: ExpressionPart) -> Iterator[ExpressionCandidate]:
    """Yields the expressions in which a superlative or an ordinal selects the target among the objects that the head
    and a relation fit.

    Without the relation, the same superlative or ordinal does not select the target.
    """
    without = {one.selector for one in search.selectors(head)}
    for one in search.selectors(head, (part,)):
        if _is_readable(one) and one.selector not in without:
            yield one


def _is_readable(one: ExpressionCandidate) -> bool:
    """Returns whether it is clear which objects an expression counts, or among which it selects the farthest."""
    families = {FAMILY[part.clause.relation] for part in one.parts}
    if one.ordinal is not None:
        return families <= _WITH_ORDINAL
    is_farthest = one.superlative is not None and one.superlative.relation is Relation.FARTHEST_FROM
    return not is_farthest or Family.ROOM in families


def indefinite_candidates(search: Search) -> list[ExpressionCandidate]:
    """Returns candidates for expressions with "a" that fit the target and other objects, without borderline cases."""
    parts = search.parts()
    candidates = []
    for head in search.heads():
        for chosen in ((), *((part,) for part in parts)):
            masks = head.masks.both(chosen[0].masks) if chosen else head.masks
            if masks.sure[search.number] and masks.sure.sum() > 1 and (masks.sure == masks.possible).all():
                candidates.append(ExpressionCandidate(head, chosen))
    return candidates


def redundant_expressions(search: Search, expression: Expression) -> list[Expression]:
    """Returns variants of an expression with one more part that surely holds for the target, such as its colour."""
    expressions: list[Expression] = []
    if expression.selectors:
        return expressions  # another part would change the set from which a superlative or an ordinal selects
    for head in search.heads():
        looks = {name: value for name in ("colour", "material") if (value := getattr(head, name)) is not None}
        if head.kind == expression.kind and looks and all(getattr(expression, name) is None for name in looks):
            expressions.append(expression.model_copy(update=looks))
    if len(expression.clauses) < 2:
        named = {clause.relation for clause in expression.clauses}
        for part in search.parts():
            if part.clause.relation not in named:
                expressions.append(expression.model_copy(update={"clauses": (part.clause, *expression.clauses)}))
    return expressions
