"""Specs of every recorded array, shared by recorder, validator and reader.

Describes and checks arrays. Does not compute, store or convert them.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, DTypeLike, NDArray

from schemas.encoding.image_sizes import FRAME_SIZE_PX


@dataclass(frozen=True)
class ArraySpec:
    """Shape, dtype, unit and bounds of an array."""

    name: str
    """Name of the array."""
    shape: tuple[int | None, ...]
    """Shape of the array; `None` is the episode length T."""
    dtype: DTypeLike
    """Type of the elements."""
    unit: str
    """Unit of the values."""
    low: float | tuple[float, ...] | None = None
    """Smallest valid value, or one for each column of the last axis; `None` for no bound."""
    high: float | tuple[float, ...] | None = None
    """Largest valid value, or one for each column of the last axis; `None` for no bound."""
    former_dtype: DTypeLike | None = None
    """Type of the elements in bundles of format 1; `None` if it is `dtype`."""
    may_be_nan: bool = False
    """Whether NaN, which means no value, is valid."""

    def violations(self, array: NDArray[np.generic], length: int | None = None) -> list[str]:
        """Returns all violations of the spec by `array`, with expected and actual values.

        Args:
            array: the array to check.
            length: the episode length T that a `None` in the shape must equal; `None` accepts any.

        Returns:
            One sentence for each violation; empty if the array is valid.
        """
        wanted = tuple(length if side is None else side for side in self.shape)
        fits = array.ndim == len(wanted) and all(
            want is None or want == got for want, got in zip(wanted, array.shape, strict=True)
        )
        if not fits:
            return [f"{self.name}: shape {array.shape}, expected {self._show_shape(length)}"]
        if array.dtype not in (self.dtype, self.former_dtype or self.dtype):
            return [f"{self.name}: dtype {array.dtype}, expected {np.dtype(self.dtype)}"]
        return self.value_violations(array)

    def value_violations(self, array: NDArray[Any]) -> list[str]:
        """Returns the violations of the bounds by an array whose shape and dtype were checked before."""
        has_bounds = self.low is not None or self.high is not None
        if has_bounds and self.may_be_nan:
            array = array[~np.isnan(array).all(axis=-1)]  # a row without a value has no bounds; half a row is a mistake
        is_free = array.dtype.kind != "f" or self.may_be_nan
        if array.size == 0 or (not has_bounds and (is_free or np.isfinite(array).all())):
            return []
        if self.low is not None and self.high is not None and (array >= self.low).all() and (array <= self.high).all():
            return []  # the usual case; any comparison with NaN is false
        axes = tuple(range(array.ndim - 1)) if isinstance(self.low or self.high, tuple) else None
        return self.range_violations(array.min(axes), array.max(axes))

    def range_violations(self, least: ArrayLike, most: ArrayLike) -> list[str]:
        """Returns the violations of the bounds by values that range from `least` to `most`.

        Args:
            least: minimum of the array, or of each column if the bounds are tuples; NaN if a value is NaN.
            most: maximum of the array, or of each column if the bounds are tuples; NaN if a value is NaN.
        """
        if not (np.isfinite(least).all() and np.isfinite(most).all()):
            return [f"{self.name}: contains NaN or infinity"]
        findings = []
        if self.low is not None and np.less(least, self.low).any():
            findings.append(f"{self.name}: minimum {np.min(least)} is below {self.low} {self.unit}")
        if self.high is not None and np.greater(most, self.high).any():
            findings.append(f"{self.name}: maximum {np.max(most)} is above {self.high} {self.unit}")
        return findings

    def _show_shape(self, length: int | None) -> str:
        return "(" + ", ".join(str(side if side is not None else length or "T") for side in self.shape) + ")"


RGB_FRAME = ArraySpec("rgb_front", (FRAME_SIZE_PX, FRAME_SIZE_PX, 3), np.uint8, "sRGB")
"""Colour image of the front camera, rows from top to bottom."""

DEPTH_FRAME = ArraySpec("depth_front", (FRAME_SIZE_PX, FRAME_SIZE_PX), dtype=np.float32, unit="m", low=0.0, high=30.0)
"""Distance along the optical axis; 0 where no surface is within the clip range."""

IDS_FRAME = ArraySpec("seg_front", (FRAME_SIZE_PX, FRAME_SIZE_PX), np.uint16, "instance id")
"""Instance id of the nearest surface, 0 for no surface; `meta.json` maps each id to its prim."""

ACTIONS_CONTINUOUS = ArraySpec(
    "actions_continuous", (None, 2), dtype=np.float32, unit="(m/s, rad/s)", low=(0.0, -1.5), high=(1.0, 1.5)
)
"""Commanded twist (v, w) of every step, after the slew limit."""

ACTIONS_TOKENS = ArraySpec("actions_tokens", (None, 2), dtype=np.int16, unit="token", low=0, high=6)
"""Grid point of the 7 x 7 grid that is nearest to each action."""

POSES = ArraySpec("poses", (None, 7), np.float64, "(m, m, m, quaternion w x y z)", former_dtype=np.float32)
"""Pose of base_link in the world frame at each frame: (x, y, z, qw, qx, qy, qz); exact, so the frame can be
rendered again."""

EXPERT_ACTIONS = ArraySpec(
    "expert_actions",
    (None, 2),
    dtype=np.float32,
    unit="(m/s, rad/s)",
    low=(0.0, -1.5),
    high=(1.0, 1.5),
    may_be_nan=True,
)
"""Twist (v, w) that the planner wants at the pose of a step, before the slew limit; NaN in steps without a label."""

DRIVERS = ArraySpec("drivers", (None,), dtype=np.uint8, unit="who acts", low=0, high=2)
"""Who acted in each step, as `schemas.terms.Driver` numbers them."""

ROUTE = ArraySpec("route_m", (None,), dtype=np.float32, unit="m", low=0.0, high=1000.0)
"""Distance of base_link from the planner's path of the start, for which the instruction was written or verified."""

CORRECTION_ARRAYS = (EXPERT_ACTIONS, DRIVERS, ROUTE)
"""Arrays of an episode with corrections, after those of every bundle."""

EPISODE_ARRAYS = (ACTIONS_CONTINUOUS, ACTIONS_TOKENS, POSES)
"""Arrays of a bundle other than frames, in the order of the file."""
