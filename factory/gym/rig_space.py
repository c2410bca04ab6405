"""Observation space of the sensors of a rig: a box for each array, with the key `SENSOR/ARRAY`. Measures nothing."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from factory.eval.driving.rig_sensors import SensorArrays, live_arrays, require_live
from schemas.encoding.arrays import ArraySpec
from schemas.rig import Rig
from schemas.rig.file import load_rig

_UNBOUNDED = {"f": 1e9, "i": 2**53}
"""Bound of a box for values without a limit, by kind of NumPy type. Gymnasium's checker warns of infinite bounds."""


def live_rig(rig: str | Path | Rig, control_hz: int) -> Rig:
    """Returns a rig that can be measured during a drive.

    Raises:
        UsageError: The rig does not exist, has optical flow, or a package of a sensor is not installed.
        InvalidRig: The rig has mistakes, or a rate does not divide the control rate.
    """
    found = rig if isinstance(rig, Rig) else load_rig(str(rig), control_hz)
    require_live(found, control_hz)
    return found


def rig_spaces(rig: Rig) -> dict[str, spaces.Space[Any]]:
    """Returns the box of each array of a rig; arrays of instance ids are omitted."""
    return {spec.name: _box(spec) for sensor in rig.sensors for spec in live_arrays(sensor).values()}


def flat(measured: SensorArrays) -> dict[str, NDArray[Any]]:
    """Returns the arrays of all sensors by the keys of `rig_spaces`."""
    return {f"{sensor}/{name}": array for sensor, arrays in measured.items() for name, array in arrays.items()}


def _box(spec: ArraySpec) -> spaces.Box:
    dtype = np.dtype(spec.dtype)
    most: float = np.iinfo(dtype).max if dtype.kind == "u" else _UNBOUNDED[dtype.kind]
    low, high = spec.low, spec.high
    assert not isinstance(low, tuple)
    assert not isinstance(high, tuple)
    least = 0 if dtype.kind == "u" else -most
    shape = tuple(side for side in spec.shape if side is not None)
    return spaces.Box(least if low is None else low, most if high is None else high, shape, dtype.type)
