"""Image of the robot's camera: the same type in renderers, bundles and readers. Reads and renders nothing."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray


class Frame(NamedTuple):
    """Image of the robot's camera before one action; rows from the top. A recorded frame has 640 x 640 pixels."""

    rgb: NDArray[np.uint8]
    """(size, size, 3) sRGB; where no surface is visible, the sky of the scene, or black without one."""
    depth: NDArray[np.float32]
    """(size, size) metres along the optical axis; 0 where no surface is within the clip range."""
    ids: NDArray[np.uint16]
    """(size, size) instance id of the nearest surface, described by `Episode.instances`; 0 for no surface."""
