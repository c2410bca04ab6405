"""Names and definitions of all measures, for pages, reports and the terminal. Pure functions."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from types import MappingProxyType

from schemas.terms import SuccessMeasure

PLACES: Mapping[SuccessMeasure, str] = MappingProxyType(
    {SuccessMeasure.CENTROID: "centroid", SuccessMeasure.SURFACE: "footprint"}
)
"""Part of the target that a distance is measured to."""
_NE = "navigation error: planar distance from the robot to the {} at the end of the episode"
_TL = "trajectory length: length of the driven path"
_OP = "oracle progress: covered fraction of the start distance, {}"
DEFINITIONS: Mapping[str, str] = MappingProxyType(
    {
        "NE": _NE.format("target") + ", by the measure that decides about success",
        "NE to the centroid": _NE.format("centroid of the target"),
        "NE to the footprint": _NE.format("footprint of the target"),
        "TL": _TL,
        "trajectory length": _TL,
        "start distance": "planar distance from the robot to the centroid of the target at the start of the episode",
        "distance to the target": "planar distance from the robot to the target, by the measure that decides about "
        "success",
        "SR": "success rate: share of the episodes that end stationary within the success radius",
        "oracle success": "share of the episodes in which the robot was within the success radius of the target at any "
        "time, with or without a stop",
        "any instance": "share of the episodes that end stationary within the success radius of the target or of "
        "another object of its category",
        "SPL": "success weighted by path length: shortest path divided by driven path, 0 without success",
        "soft-SPL": "SPL with the covered fraction of the start distance instead of success",
        "OP final": _OP.format("at the end"),
        "OP closest": _OP.format("at the point closest to the target"),
        "OP normalised": _OP.format("at the point closest to the target, both distances less the success radius"),
        "steps": "number of control steps",
        "collision": "share of the episodes that end with a collision",
        "contact": "share of the episodes in which the robot touched an object",
        "timeout": "share of the episodes that reach the largest number of steps",
        "policy failure": "share of the episodes in which the policy failed, for example by an exception",
        "detour": "trajectory length less the difference of start distance and NE",
        "shortest path": "length of the shortest path along the floor from the start to the success region",
    }
)
"""Definition of each measure by its name. Each name has this meaning on every page and in every table."""
TITLES: Mapping[str, str] = MappingProxyType(
    {
        "success": "SR",
        "spl": "SPL",
        "ne_m": "NE, m",
        "ne_centroid_m": "NE to the centroid, m",
        "ne_surface_m": "NE to the footprint, m",
        "soft_spl": "soft-SPL",
        "progress_final": "OP final",
        "progress_max": "OP closest",
        "progress_normalised": "OP normalised",
        "trajectory_length_m": "TL, m",
        "num_steps": "steps",
    }
)
"""Title with unit of each measure of an evaluation, by its field in `results.json`."""


def define(title: str) -> str:
    """Returns the definition of the measure that a title begins with; empty for other titles."""
    return DEFINITIONS.get(_name_of(title), "")


def definitions_of(titles: Iterable[str]) -> dict[str, str]:
    """Returns the definitions of the measures that titles begin with, by name, each once."""
    return {name: DEFINITIONS[name] for title in titles if (name := _name_of(title))}


def _name_of(title: str) -> str:
    """Returns the longest name of a measure that a title begins with; empty if there is none."""
    names = [name for name in DEFINITIONS if title == name or title.startswith((f"{name} ", f"{name},"))]
    return max(names, key=len, default="")
