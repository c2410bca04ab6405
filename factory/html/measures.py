"""Names and definitions of the measures that the pages show. Pure functions."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType

from schemas.terms import SuccessMeasure

PLACES: Mapping[SuccessMeasure, str] = MappingProxyType(
    {SuccessMeasure.CENTROID: "centroid", SuccessMeasure.SURFACE: "footprint"}
)
"""Part of the target that a distance is measured to."""
_DEFINITIONS = MappingProxyType(
    {
        "NE to the centroid": "navigation error: planar distance from the robot to the centroid of the target at the "
        "end of the episode",
        "NE to the footprint": "navigation error: planar distance from the robot to the footprint of the target at the "
        "end of the episode",
        "NE": "navigation error: planar distance from the robot to the target at the end of the episode, by the "
        "measure that decides about success",
        "TL": "trajectory length: length of the driven path",
        "SR": "success rate: share of the episodes that end stationary within the success radius",
        "SPL": "success weighted by path length: shortest path divided by driven path, 0 without success",
        "soft-SPL": "SPL with the covered fraction of the start distance instead of success",
        "OP": "oracle progress: covered fraction of the start distance",
        "steps": "number of control steps",
    }
)


def define(title: str) -> str:
    """Returns the definition of the measure that a title begins with; empty for other titles."""
    names = [name for name in _DEFINITIONS if title == name or title.startswith((f"{name} ", f"{name},"))]
    return _DEFINITIONS[max(names, key=len)] if names else ""
