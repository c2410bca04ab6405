"""Determines unit and up axis of a 3D file: as stated in the file, or as given by the user.

Pure functions. Errors list the size of the scene for each unit, so the user can choose.
"""

from __future__ import annotations

from types import MappingProxyType

import numpy as np

from factory.scenes.formats.shapes import Content
from factory.scenes.limits import StageLimits, Unit
from schemas.errors import UsageError, WorldError
from schemas.support.numpy_types import Floats

METRES = MappingProxyType({"m": 1.0, "cm": 0.01, "mm": 0.001, "in": 0.0254})
"""Unit -> metres."""
_PLAUSIBLE_M = (1.0, 2000.0)
_Y_TO_Z = np.array([[1.0, 0, 0, 0], [0, 0, -1, 0], [0, 1, 0, 0], [0, 0, 0, 1]])


def to_metres(metres_per_unit: float, up: str) -> Floats:
    """Returns the transform (4, 4) file -> metres, z up."""
    turn = _Y_TO_Z if up == "y" else np.eye(4)
    return np.asarray(np.diag([metres_per_unit] * 3 + [1.0]) @ turn)


def resolve_units(file: str, content: Content, limits: StageLimits) -> tuple[Floats, float]:
    """Returns the transform (4, 4) file -> metres, z up, and the length of the unit, metres.

    Args:
        file: name of the file, for messages.
        content: content of the file.
        limits: unit and up axis of the user, which override those of the file.

    Raises:
        UsageError: the unit or the up axis is neither stated in the file nor given by the user.
        WorldError: the scene would be implausibly small or large.
    """
    corners = content.corners()
    size = np.ptp(corners, axis=0) if len(corners) else np.zeros(3)
    unit = content.metres_per_unit if limits.unit is None else _length_of(limits.unit)
    up = limits.up or content.up
    missing = [
        *(["its unit (--unit m|cm|mm|in|METRES)"] if unit is None else []),
        *(["its up axis (--up y|z)"] if up is None else []),
    ]
    if unit is None or up is None:
        raise UsageError(f"{file} does not state {' and '.join(missing)}; {_sizes(size)}; a room is 2 to 4 m high")
    width = float(np.delete(size, "xyz".index(up)).max()) * unit
    if len(corners) and not _PLAUSIBLE_M[0] <= width <= _PLAUSIBLE_M[1]:
        raise WorldError(
            f"{file} is {width:.4g} m wide with a unit of {unit:g} m, which is implausible for a scene; "
            f"{_sizes(size)}; give the unit with --unit m|cm|mm|in|METRES"
        )
    return to_metres(unit, up), unit


def _length_of(unit: Unit) -> float:
    return unit if isinstance(unit, float) else METRES[unit]


def _sizes(size: Floats) -> str:
    lines = (
        f"{' x '.join(f'{value * metres:.3g}' for value in size)} m with {unit}" for unit, metres in METRES.items()
    )
    return f"its size (x, y, z) is {', '.join(lines)}"
