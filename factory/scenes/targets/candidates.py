"""Finds target candidates: prims whose names, shapes and colours match a category rule. The outermost match applies.

A footprint is the convex hull of the projection to the floor, computed with integers of tenths of a millimetre, so it
does not depend on the machine. Does not read stages and does not compute reachability.
"""

from __future__ import annotations

import re
from collections import defaultdict
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from factory.scenes.importer import Extraction, Part
from factory.scenes.rules import CategoryRule, RuleBook, split_name
from schemas.scene import Footprint
from schemas.support.numpy_types import Floats

_PER_METRE = 10_000
_MOST_VERTICES = 64

Vertex = tuple[int, int]


def footprint_of(triangles: Floats) -> Footprint:
    """Returns the vertices of the convex hull in the plane, counter-clockwise, metres.

    If there are more than 64 vertices, those that contribute the least area are removed. This makes the hull of a
    circle with a radius of 1 m at most 1.2 mm smaller.

    Args:
        triangles: (T, 3, 3) corners of the object, world metres.
    """
    plan = np.unique(np.rint(triangles.reshape(-1, 3)[:, :2] * _PER_METRE).astype(np.int64), axis=0)
    first = np.flatnonzero(np.diff(plan[:, 0], prepend=plan[0, 0] - 1))  # sorted by x, then by y
    last = np.append(first[1:], len(plan)) - 1
    ends = [(int(x), int(y)) for x, y in plan[np.unique(np.concatenate([first, last]))]]
    hull = _half(ends) + _half(reversed(ends)) if len(ends) > 1 else ends
    return tuple((x / _PER_METRE, y / _PER_METRE) for x, y in _reduced(hull))


def _half(points: Iterable[Vertex]) -> list[Vertex]:
    """Returns one half of the hull of sorted points without its last vertex (Andrew's monotone chain)."""
    chain: list[Vertex] = []
    for point in points:
        while len(chain) > 1 and _twice_area(chain[-2], chain[-1], point) <= 0:
            chain.pop()
        chain.append(point)
    return chain[:-1]


def _twice_area(a: Vertex, b: Vertex, c: Vertex) -> int:
    return (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])


def _reduced(hull: list[Vertex]) -> list[Vertex]:
    while len(hull) > _MOST_VERTICES:
        areas = [_twice_area(hull[k - 1], hull[k], hull[(k + 1) % len(hull)]) for k in range(len(hull))]
        del hull[areas.index(min(areas))]
    return hull


Box = NDArray[np.float64]
"""(2, 3) lower and upper corner, world metres."""


@dataclass(frozen=True)
class Candidate:
    """Prim that matches a category rule, reachable or not."""

    path: str
    category: str
    box: Box


@dataclass
class _Tree:
    parts: Sequence[Part]
    extraction: Extraction
    rules: RuleBook
    colour_of: Callable[[list[Part]], str]
    boxes: dict[str, Box] = field(default_factory=dict)
    children: dict[str, list[str]] = field(default_factory=lambda: defaultdict(list))

    def rule_of(self, path: str) -> CategoryRule | None:
        """Returns the first rule that a prim fits by name, size, shape and colour, or `None`."""
        name = self.extraction.labels.get(path) or path.rpartition("/")[2]
        return next((rule for rule in self.rules.matches(name) if self._fits(path, rule)), None)

    def _fits(self, path: str, rule: CategoryRule) -> bool:
        size = np.ptp(self.boxes[path], axis=0)
        low, high = rule.height_m
        if not (rule.smallest_m <= size.max() <= rule.largest_m and low <= size[2] <= high):
            return False
        if rule.thickest_m is None and not rule.colours:
            return True
        parts = [part for part in self.parts if part.path == path or part.path.startswith(f"{path}/")]
        width = footprint_width(np.concatenate([part.triangles for part in parts]))
        if rule.thickest_m is not None and width > rule.thickest_m:
            return False
        return not rule.colours or self.colour_of(parts) in rule.colours


def find_candidates(
    extraction: Extraction, parts: Sequence[Part], rules: RuleBook, colour_of: Callable[[list[Part]], str]
) -> tuple[Candidate, ...]:
    """Finds the candidates among the visible parts.

    Args:
        extraction: extracted stage, for its labels, groups and components.
        parts: visible parts; their vertices define the boxes.
        rules: category rules.
        colour_of: function that returns the colour name of an object with the given parts.

    Returns:
        The candidates in the order of their paths.
    """
    tree = _Tree(parts, extraction, rules, colour_of)
    _grow(tree)
    return tuple(sorted(_search(tree, ""), key=lambda candidate: candidate.path))


def find_named(extraction: Extraction, kind_of_name: Callable[[str, str], str]) -> dict[str, list[Box]]:
    """Returns the boxes of the outermost prims with a name of each kind, whatever their size.

    Args:
        extraction: extracted stage.
        kind_of_name: function that returns the kind of a name or label and the path above it, or an empty string.
    """
    tree = _Tree(extraction.parts, extraction, RuleBook(rules=()), lambda _: "")
    _grow(tree)
    kinds: dict[str, list[Box]] = defaultdict(list)

    def kind_of(path: str) -> str:
        above, _, name = path.rpartition("/")
        return "" if path in extraction.groups else kind_of_name(extraction.labels.get(path) or name, above)

    pending = list(tree.children.get("", ()))
    while pending:
        path = pending.pop()
        kind, children = kind_of(path), tree.children.get(path, [])
        if kind and sum(kind_of(child) == kind for child in children) < 2:
            kinds[kind].append(tree.boxes[path])
        else:
            pending += children
    return kinds


_SAME_SHARE = 0.85
"""Two candidates of a category are one object if their boxes share this part of their union."""


def find_copies(candidates: Sequence[Candidate]) -> dict[str, str]:
    """Returns the path of each candidate that is drawn at the place of an earlier one of its category -> that one.

    Args:
        candidates: candidates in the order of their paths.
    """
    copies: dict[str, str] = {}
    for number, later in enumerate(candidates):
        for first in candidates[:number]:
            if first.category == later.category and first.path not in copies and _share(first, later) >= _SAME_SHARE:
                copies[later.path] = first.path
                break
    return copies


_TOUCHING_M = 0.02
_SEATS = ("sofa", "bed")
_APPLIANCES = frozenset(
    {"refrigerator", "oven", "sink", "dishwasher", "washing_machine", "toilet", "bathtub", "microwave"}
)
_INSIDE_SHARE = 0.95
_SECTION = re.compile(r"left|right|middle|mid|center|centre|corner|section|segment|module|element|part|link|\d+|[a-z]")
_STRUCTURE = re.compile(r"seat|back|arm|base|frame|body|top|bottom|front|side|rest|backrest|armrest|cushion|leg")


def find_sections(candidates: Sequence[Candidate]) -> dict[str, str]:
    """Returns the path of each candidate that is a part of an earlier one, to which it is joined -> that one.

    Parts are candidates of one category that touch and whose names have only different words for parts: `sofa_seat` and
    `sofa_back`. Sofas and beds also have sections: `couch_left` and `couch_middle`, and
    appliances have parts of any name inside them: an oven in an `oven_area`.

    Args:
        candidates: candidates in the order of their paths.
    """
    sections: dict[str, str] = {}
    for number, later in enumerate(candidates):
        for first in candidates[:number]:
            if first.category == later.category and _is_section(first, later):
                sections[later.path] = sections.get(first.path, first.path)
                break
    return sections


def joined(candidates: Sequence[Candidate], parts: Mapping[str, str]) -> tuple[Candidate, ...]:
    """Returns the candidates with the boxes of their parts, which `parts` assigns to the path of a candidate."""
    boxes: dict[str, list[Box]] = defaultdict(list)
    for candidate in candidates:
        boxes[parts.get(candidate.path, candidate.path)].append(candidate.box)
    return tuple(
        replace(one, box=_union(boxes[one.path])) if len(boxes[one.path]) > 1 else one
        for one in candidates
        if one.path not in parts
    )


def _union(boxes: Sequence[Box]) -> Box:
    return np.stack([np.min([box[0] for box in boxes], axis=0), np.max([box[1] for box in boxes], axis=0)])


def _is_section(first: Candidate, later: Candidate) -> bool:
    apart = np.maximum(first.box[0], later.box[0]) - np.minimum(first.box[1], later.box[1])
    if apart.max() > _TOUCHING_M or _parent(first.path) != _parent(later.path):
        return False
    if first.category in _APPLIANCES and _inside(first, later) >= _INSIDE_SHARE:
        return True
    names = [split_name(one.path.rpartition("/")[2]).split("_") for one in (first, later)]
    differing = {*names[0]} ^ {*names[1]}
    if first.category in _SEATS:
        return all(_SECTION.fullmatch(word) or _STRUCTURE.fullmatch(word) for word in differing)
    return bool(differing) and all(_STRUCTURE.fullmatch(word) for word in differing)


def _inside(first: Candidate, later: Candidate) -> float:
    """Returns the volume of the intersection of two boxes as a share of the smaller one."""
    low, high = np.maximum(first.box[0], later.box[0]), np.minimum(first.box[1], later.box[1])
    common, one, other = (np.maximum(size, 1e-3).prod() for size in (high - low, *map(_size, (first, later))))
    return float(common / min(one, other))


def _share(first: Candidate, later: Candidate) -> float:
    """Returns the volume of the intersection of two boxes as a share of their union."""
    low, high = np.maximum(first.box[0], later.box[0]), np.minimum(first.box[1], later.box[1])
    if (high < low).any():
        return 0.0
    # thin objects, such as posters, have a volume, too
    common, one, other = (np.maximum(size, 1e-3).prod() for size in (high - low, *map(_size, (first, later))))
    return float(common / (one + other - common))


def _size(candidate: Candidate) -> NDArray[np.float64]:
    return np.asarray(candidate.box[1] - candidate.box[0])


def footprint_width(triangles: NDArray[np.float64]) -> float:
    """Returns the width of the narrowest strip of floor that contains the footprint of triangles (T, 3, 3), metres."""
    hull = np.array(footprint_of(triangles))
    sides = np.roll(hull, -1, axis=0) - hull
    lengths = np.maximum(np.linalg.norm(sides, axis=1), 1e-9)
    across = sides[:, :1] / lengths[:, None] * hull[:, 1] - sides[:, 1:] / lengths[:, None] * hull[:, 0]
    return float(np.ptp(across, axis=1).min())


def _grow(tree: _Tree) -> None:
    for part in tree.parts:
        corners = part.triangles.reshape(-1, 3)
        box = np.stack([corners.min(axis=0), corners.max(axis=0)])
        path = part.path
        while path:
            known = tree.boxes.get(path)
            if known is None:
                tree.children[_parent(path)].append(path)
                tree.boxes[path] = box.copy()
            else:
                tree.boxes[path] = np.stack([np.minimum(known[0], box[0]), np.maximum(known[1], box[1])])
            path = _parent(path)


def _parent(path: str) -> str:
    return path.rpartition("/")[0]


def _search(tree: _Tree, path: str) -> Iterator[Candidate]:
    rule = tree.rule_of(path) if path and path not in tree.extraction.groups else None
    if rule is not None and not _is_container(tree, path, rule.category):
        yield Candidate(path, rule.category, tree.boxes[path])
    elif path not in tree.extraction.components:
        for child in tree.children.get(path, ()):
            yield from _search(tree, child)


def _is_container(tree: _Tree, path: str, category: str) -> bool:
    """Returns whether a prim is a container: two of its children have its category and boxes disjoint in plan."""
    if path in tree.extraction.components or path in tree.extraction.articulated:
        return False
    rules = ((child, tree.rule_of(child)) for child in tree.children.get(path, ()))
    alike = [tree.boxes[child][:, :2] for child, rule in rules if rule and rule.category == category]
    return any(
        bool((first[0] >= other[1]).any() or (other[0] >= first[1]).any())
        for number, first in enumerate(alike)
        for other in alike[number + 1 :]
    )
