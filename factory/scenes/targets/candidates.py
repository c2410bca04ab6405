"""Finds target candidates: prims whose names match a category rule. The outermost match applies.

Pure: works on paths, boxes and rules. Does not read stages and does not compute reachability.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from factory.scenes.importer.extract import Extraction, Part
from factory.scenes.rules import RuleBook

__all__ = ["Candidate", "find_candidates"]

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
    boxes: dict[str, Box] = field(default_factory=dict)
    children: dict[str, list[str]] = field(default_factory=lambda: defaultdict(list))


def find_candidates(extraction: Extraction, parts: Sequence[Part], rules: RuleBook) -> tuple[Candidate, ...]:
    """Finds the candidates among the visible parts.

    Args:
        extraction: extracted stage, for its labels, groups and components.
        parts: visible parts; their vertices define the boxes.
        rules: category rules.

    Returns:
        The candidates in the order of their paths.
    """
    tree = _grow(parts)
    found = _search(tree, "", extraction, rules)
    return tuple(sorted(found, key=lambda candidate: candidate.path))


def _grow(parts: Sequence[Part]) -> _Tree:
    tree = _Tree()
    for part in parts:
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
    return tree


def _parent(path: str) -> str:
    return path.rpartition("/")[0]


def _search(tree: _Tree, path: str, extraction: Extraction, rules: RuleBook) -> Iterator[Candidate]:
    rule = rules.match(_name(path, extraction)) if path else None
    if rule is not None and path not in extraction.groups:
        longest = float(np.ptp(tree.boxes[path], axis=0).max())
        is_plausible = rule.smallest_m <= longest <= rule.largest_m
        if is_plausible and not _is_container(tree, path, rule.category, extraction, rules):
            yield Candidate(path, rule.category, tree.boxes[path])
            return
    if path not in extraction.components:
        for child in tree.children.get(path, ()):
            yield from _search(tree, child, extraction, rules)


def _name(path: str, extraction: Extraction) -> str:
    return extraction.labels.get(path) or path.rpartition("/")[2]


def _is_container(tree: _Tree, path: str, category: str, extraction: Extraction, rules: RuleBook) -> bool:
    """Returns whether a prim is a container: two of its children have its category and disjoint boxes."""
    if path in extraction.components:
        return False
    matches = ((child, rules.match(_name(child, extraction))) for child in tree.children.get(path, ()))
    alike = [tree.boxes[child][:, :2] for child, rule in matches if rule and rule.category == category]
    return any(
        bool((first[0] >= other[1]).any() or (other[0] >= first[1]).any())
        for number, first in enumerate(alike)
        for other in alike[number + 1 :]
    )
