"""Estimates from doors, tables, chairs and beds whether a scene has its true size. Pure functions."""

from __future__ import annotations

import re
from collections.abc import Sequence

import numpy as np

from factory.scenes.importer import Extraction
from factory.scenes.rules import builtin_rules, split_name
from factory.scenes.targets.candidates import Box, find_named

_DOOR = re.compile(r"(?:^|_)doors?(?:_(?:\d+|[a-z]))*$")
_NO_DOOR = re.compile(
    "cabinet|cupboard|fridge|refrigerator|oven|closet|wardrobe|microwave|washer|locker|car_|cat_|glove|garage|out_?door|"
    "in_?door|shower|furnace"
)
_USUAL_M = {"door": (2.05, 1.8, 2.7), "chair": (0.88, 0.68, 1.3), "table": (0.74, 0.4, 1.15), "bed": (2.05, 1.6, 2.4)}
"""Kind -> usual height, and the least and greatest one; of beds, the length. Metres."""
_LEAST_OBJECTS = 2
_PLAUSIBLE = (0.8, 1.25)
UNITS_M = {"m": 1.0, "cm": 0.01, "mm": 0.001, "in": 0.0254, "0.3048": 0.3048}
_NEAR = 0.06
_SPREAD = 1.6
"""Greatest quotient of the scales of two kinds; others are names of different things."""


def scale_note(extraction: Extraction, can_give_unit: bool) -> str:
    """Returns a note if the sizes of doors, tables, chairs and beds suggest another unit; otherwise an empty string.

    Args:
        extraction: content of the file.
        can_give_unit: whether --unit is an option for its format.
    """
    found = sorted(find_named(extraction, _kind_of).items())
    sizes, counts = {kind: _size_m(kind, boxes) for kind, boxes in found}, {kind: len(boxes) for kind, boxes in found}
    if not sizes or (sum(counts.values()) < _LEAST_OBJECTS and "door" not in sizes):
        return ""
    ratios = {kind: size / _USUAL_M[kind][0] for kind, size in sizes.items()}
    ratio = float(np.median(list(ratios.values())))
    is_usual = [_USUAL_M[kind][1] <= size <= _USUAL_M[kind][2] for kind, size in sizes.items()]
    agree = max(ratios.values()) <= _SPREAD * min(ratios.values())
    if _PLAUSIBLE[0] <= ratio <= _PLAUSIBLE[1] or np.mean(is_usual) > 0.5 or not agree:
        return ""
    seen = ", ".join(f"{counts[kind]} {kind} of {sizes[kind]:.3g} m (usual: {_USUAL_M[kind][0]:g} m)" for kind in sizes)
    unit = extraction.metres_per_unit / ratio
    name = next((name for name, metres in UNITS_M.items() if abs(unit / metres - 1) < _NEAR), f"{unit:.3g}")
    remedy = (
        f"if so, import again with --unit {name}"
        if can_give_unit
        else f"if so, scale it by {1 / ratio:.3g} in its file (for a USD stage: metersPerUnit = {unit:.3g})"
    )
    return f"the scene may have {ratio:.2g} times its true size: {seen}; {remedy}"


def _kind_of(name: str, above: str) -> str:
    words = split_name(name)
    if _DOOR.search(words):  # the door of a cabinet is part of a prim that is named after it
        return "" if _NO_DOOR.search(f"{split_name(above)}_{words}") else "door"
    rule = builtin_rules().match(name)
    return rule.category if rule is not None and rule.category in _USUAL_M else ""


def _size_m(kind: str, boxes: Sequence[Box]) -> float:
    """Returns the usual height of a kind (length of beds), metres, without boxes of less than half of the largest."""
    sides = np.array([box[1] - box[0] for box in boxes])
    lengths = sides[:, :2].max(axis=1) if kind == "bed" else sides[:, 2]
    return max(float(np.median(lengths[lengths >= lengths.max() / 2])), 1e-6)  # smaller ones are parts
