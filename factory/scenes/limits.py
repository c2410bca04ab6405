"""Options of a scene import: limits, files outside the scene's folder, unit and up axis, and an added floor or ceiling.

Data only; the importer enforces the limits.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Literal

MAX_TRIANGLES = 10_000_000
MAX_FILE_MB = 1000
UnitName = Literal["m", "cm", "mm", "in"]
Unit = UnitName | float
"""Unit of a file: its name, or its length in metres."""
UpAxis = Literal["y", "z"]
"""Axis of a file that points up."""


@dataclass(frozen=True)
class StageLimits:
    """Limits of one import."""

    max_triangles: int = MAX_TRIANGLES
    """Maximum number of triangles in the world; every instance counts."""
    allow_outside: bool = False
    """Whether textures outside the folder of the root layer are read."""
    ceiling_m: float | None = None
    """Height above the floor of a flat ceiling that is added over the stage, metres; `None` adds none."""
    unit: Unit | None = None
    """Unit of a 3D file, by name or in metres; `None` uses the unit that the file states."""
    up: UpAxis | None = None
    """Up axis of a 3D file; `None` uses the axis that the file states."""
    models: tuple[Path, ...] = ()
    """Folders in which `model://` and `package://` names are searched."""
    max_file_mb: int = MAX_FILE_MB
    """Maximum size of one file that is not USD, megabytes."""
    floor_m: float | None = None
    """Height of a flat floor that is added to a scene without one, metres; `None` adds none."""
    skip_missing: bool = False
    """Whether missing models and meshes of a world are skipped, each with a note."""


USUAL_LIMITS = StageLimits()
