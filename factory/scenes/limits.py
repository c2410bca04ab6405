"""What an import refuses: stages too large to be a robot's room, and files from elsewhere on the disk.

Data only; the importer enforces it.
"""

from __future__ import annotations

from dataclasses import dataclass

__all__ = ["MAX_TRIANGLES", "USUAL_LIMITS", "StageLimits"]

MAX_TRIANGLES = 10_000_000


@dataclass(frozen=True)
class StageLimits:
    """The limits of one import."""

    max_triangles: int = MAX_TRIANGLES
    """Triangles placed in the world, all copies counted, above which a stage is refused."""
    allow_outside: bool = False
    """Whether textures may lie outside of the folder of the stage's root layer."""


USUAL_LIMITS = StageLimits()
