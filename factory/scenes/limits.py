"""Limits of a scene import: number of triangles, and files outside the folder of the stage; and what is added to it.

Data only; the importer enforces the limits.
"""

from __future__ import annotations

from dataclasses import dataclass

MAX_TRIANGLES = 10_000_000


@dataclass(frozen=True)
class StageLimits:
    """Limits of one import."""

    max_triangles: int = MAX_TRIANGLES
    """Maximum number of triangles in the world; every instance counts."""
    allow_outside: bool = False
    """Whether textures outside the folder of the root layer are read."""
    ceiling_m: float | None = None
    """Height above the floor of a flat ceiling that is added over the stage, metres; `None` adds none."""


USUAL_LIMITS = StageLimits()
