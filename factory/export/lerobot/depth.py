"""Metric depth as 12-bit codes in the way LeRobot stores it: logarithmic, with its parameters in `info.json`. Pure.

Code 0 is 0 m, which in a dataset of ours says that nothing was hit.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

__all__ = ["LARGEST_CODE", "SHIFT_M", "DepthCode"]

LARGEST_CODE = 4095
SHIFT_M = 3.5


class DepthCode:
    """The code of depths from 0 to `far_m` metres; its steps are 2 mm wide at 0 m, 7 mm at 10 m for a range of 30 m."""

    def __init__(self, far_m: float) -> None:
        self.far_m = far_m
        self._low, self._span = np.log(SHIFT_M), np.log(far_m + SHIFT_M) - np.log(SHIFT_M)

    def encode(self, depth: NDArray[np.float32]) -> NDArray[np.uint16]:
        """Returns the codes of metres, of the same shape."""
        scaled = (np.log(depth + np.float32(SHIFT_M)) - np.float32(self._low)) * np.float32(LARGEST_CODE / self._span)
        codes: NDArray[np.uint16] = np.rint(scaled, out=scaled).clip(0, LARGEST_CODE).astype(np.uint16)
        return codes

    def decode(self, codes: NDArray[np.generic]) -> NDArray[np.float64]:
        """Returns the metres of codes."""
        metres: NDArray[np.float64] = np.exp(codes.astype(np.float64) * (self._span / LARGEST_CODE) + self._low)
        return np.clip(metres - SHIFT_M, 0.0, self.far_m)
