"""Triangles of boxes, for tests of geometry that need no whole scene."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from tests.builders.scene import Box, build_scene


def box_triangles(boxes: Sequence[Box]) -> NDArray[np.float64]:
    """Returns the (12 N, 3, 3) triangles of N boxes, counter-clockwise seen from outside, metres."""
    return build_scene(boxes).positions.reshape(-1, 3, 3).astype(np.float64)
