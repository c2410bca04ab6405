"""Realistic colours of walls, floors and objects, and the patterns that they are combined with. Data only."""

from __future__ import annotations

import functools
from types import MappingProxyType
from typing import NamedTuple

import numpy as np

from schemas.appearance.colour_names import name_indices
from workers.appearance.surfaces import rgb_of


class Material(NamedTuple):
    """Material of walls or floors."""

    pattern: str
    """Name of a pattern, see `workers.appearance.patterns`."""
    tile_m: float
    """Length of one repeat of the pattern, metres."""
    colours: tuple[str, ...]
    """sRGB colours, which multiply the pattern."""


WALLS = MappingProxyType(
    {
        "paint": Material(
            "plaster",
            1.5,
            (
                "#f2efe8",
                "#e9e4d8",
                "#dfe3e4",
                "#d8dde0",
                "#ece2cf",
                "#e3d9c3",
                "#cfd8d2",
                "#c7d3dc",
                "#e6d3c6",
                "#d5cfc4",
                "#bfc5c8",
                "#dccfb4",
                "#c8b8a0",
                "#b9c4b3",
                "#a9b8c4",
                "#d9c1ae",
                "#efe9d2",
                "#9fa8a3",
            ),
        ),
        "brick": Material("brick", 1.2, ("#9c5a44", "#a5684d", "#8d5142", "#b98b6d", "#cfc6b8", "#8f8378")),
        "concrete": Material("concrete", 3.0, ("#b5b4af", "#a7a7a3", "#c2c0ba", "#9b9a95", "#b8b0a4")),
        "panels": Material("planks", 2.4, ("#c8a577", "#b58e62", "#d6bf98", "#a67c52", "#e2dbcb", "#8a6a4c")),
        "tiles": Material("tiles", 1.2, ("#eceeec", "#dfe7e6", "#e9e3d5", "#cfdcdc", "#d7e0d2")),
    }
)
"""Materials of walls by name."""
FLOORS = MappingProxyType(
    {
        "wood": Material("planks", 1.6, ("#b98d5e", "#a0754a", "#cdaa7d", "#8a6342", "#d8bf96", "#7a5a42", "#b7a48c")),
        "tiles": Material("tiles", 1.8, ("#d0ccc2", "#b9b6ad", "#c8bfae", "#9ea3a3", "#dcd9d2", "#8c8478", "#b4a894")),
        "carpet": Material(
            "carpet", 1.0, ("#66707c", "#75716a", "#5a6f76", "#7d6c5b", "#6a6f5c", "#80616a", "#4f5a6b", "#8d8a84")
        ),
        "concrete": Material("concrete", 4.0, ("#a9a8a3", "#b7b5ae", "#98989a", "#bdb6aa", "#8f908c")),
        "linoleum": Material(
            "linoleum", 2.0, ("#a3b3b2", "#bba98c", "#9fae9d", "#b0a9a0", "#8fa0ae", "#c2b9a6", "#a99a8d")
        ),
    }
)
"""Materials of floors by name."""
CEILINGS = ("#ffffff", "#f6f4ee", "#eef0f0", "#e8e6df", "#dcdcd8", "#f3ecdd")
"""sRGB values that multiply the colours of ceilings."""
PAINTS = (
    "#141416",
    "#1c1c1f",
    "#26272a",
    "#303134",
    "#55585b",
    "#6b6e71",
    "#7d8083",
    "#8f9295",
    "#a3a6a8",
    "#b4b7b8",
    "#e4e4e1",
    "#eeeeea",
    "#f6f6f3",
    "#8e1f1b",
    "#a81f1c",
    "#b5201c",
    "#c4302a",
    "#cf3b30",
    "#c85a18",
    "#e0701a",
    "#ea8530",
    "#d8a41a",
    "#e8b81c",
    "#f0c838",
    "#e6c44e",
    "#24703a",
    "#2c8a3c",
    "#3a9a4c",
    "#4f9e52",
    "#2f6b35",
    "#3f7d4a",
    "#6a9a4a",
    "#1d4fa8",
    "#2a5db8",
    "#1f4488",
    "#3a6fc4",
    "#5b9bd5",
    "#4a86c0",
    "#2f5597",
    "#1c2b52",
    "#5d3480",
    "#6a3d8f",
    "#7d4fa0",
    "#8a5fae",
    "#d884a8",
    "#e39ab8",
    "#c96a94",
    "#5a3822",
    "#6b4226",
    "#7a4e30",
    "#8a5f3c",
    "#9a6f48",
    "#b08a5c",
)
"""Paints, plastics, fabrics and woods of objects."""


@functools.cache
def paints_named(index: int) -> tuple[str, ...]:
    """Returns the paints that have a colour name, given by its index in `COLOUR_NAMES`."""
    names = name_indices(np.array([rgb_of(paint) for paint in PAINTS]) / 255)
    return tuple(paint for paint, name in zip(PAINTS, names.tolist(), strict=True) if name == index)
