"""Determines the materials of the objects of a scene from the names of their surfaces. Reads no file."""

from __future__ import annotations

import re
from collections import defaultdict
from collections.abc import Sequence
from pathlib import PurePosixPath
from types import MappingProxyType

from factory.scenes.compile.shade import triangle_areas
from factory.scenes.importer import Part, Surface

UNKNOWN = "unknown"
_MOST, _VISIBLE = 0.6, 0.05
"""The main material of an object covers at least the share `_MOST` of its surface. Every other listed material covers
at least the share `_VISIBLE`."""
_WORD = re.compile(r"[A-Z]?[a-z]+|[A-Z]+(?![a-z])")
_SUBSTANCES = MappingProxyType(
    {
        "wood": "wood wooden oak walnut pine birch maple mahogany beech teak plywood hardwood timber",
        "metal": "metal metallic steel aluminium aluminum iron chrome chromium brass copper bronze stainless",
        "plastic": "plastic plastics polypropylene polyethylene pvc acrylic plexiglas",
        "glass": "glass",
        "fabric": "fabric cloth textile linen cotton wool velvet denim upholstery",
        "leather": "leather",
        "stone": "stone marble granite slate travertine sandstone limestone",
        "ceramic": "ceramic ceramics porcelain earthenware",
        "cardboard": "cardboard carton corrugated",
        "wicker": "wicker rattan",
        "rubber": "rubber",
        "paper": "paper",
        "concrete": "concrete cement",
        "brick": "brick bricks",
        "plaster": "plaster drywall stucco",
        "foam": "foam styrofoam",
        "leaf": "leaf leaves foliage",
        "soil": "soil earth",
    }
)
"""Words that name each substance, lower case. Words that are also colours, such as silver, are not listed."""
_BY_WORD = MappingProxyType({word: name for name, words in _SUBSTANCES.items() for word in words.split()})
_IMITATION = frozenset(("fake", "faux", "imitation", "look", "effect", "like", "spines", "holder", "frame"))
"""Words in a name that make its substance unknown, as in "fake leather" or "spines of leather books"."""


def substance_of(surface: Surface) -> str:
    """Returns the substance of a surface; `unknown` if its name states no substance or several."""
    names = (surface.name, PurePosixPath(surface.texture.replace("\\", "/")).stem)
    for name in names:  # the name of the material takes precedence over that of its texture
        words = {word.lower() for word in _WORD.findall(name)}
        found = {_BY_WORD[word] for word in words if word in _BY_WORD}
        if words & _IMITATION:
            return UNKNOWN
        if found:
            return found.pop() if len(found) == 1 else UNKNOWN
    return "metal" if surface.is_metal else UNKNOWN


def materials_of(parts: Sequence[Part], owners: Sequence[str]) -> dict[str, tuple[str, ...]]:
    """Returns the known materials of each object: first the one that covers most of it, then the others by name.

    Objects whose main material is unknown are omitted.

    Args:
        parts: visible parts.
        owners: path of the object of each part.
    """
    areas: dict[str, dict[str, float]] = defaultdict(lambda: defaultdict(float))
    for part, owner in zip(parts, owners, strict=True):
        areas[owner][substance_of(part.surface)] += float(triangle_areas(part.triangles).sum())
    found = {}
    for owner, shares in areas.items():
        total, first = sum(shares.values()), max(shares, key=shares.__getitem__)
        most = shares[first]
        if first != UNKNOWN and total > 0 and most >= _MOST * total:
            others = sorted(name for name, area in shares.items() if name != first and area >= _VISIBLE * total)
            found[owner] = (first, *others)
    return found
