"""Paints the sky of an open scene into the pixels without a surface: the same bytes for all renderers.

Does not change depth or ids.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from schemas.scene import Sky
from workers.geometry.camera import OpticalPose, Perspective

_HAZE = 0.08
"""Sine of the angle below the horizon at which the ground is free of haze."""


class SkyPainter:
    """Painter of one sky; keeps the last image, because most poses have the same tilt."""

    def __init__(self, sky: Sky | None) -> None:
        """Prepares the painter; `None` leaves frames as they are."""
        self._sky = sky
        self._key: tuple[bytes, Perspective] | None = None
        self._image = np.empty((0, 0, 3), np.uint8)

    def paint(
        self, rgb: NDArray[np.uint8], depth: NDArray[np.float32], optical: OpticalPose, view: Perspective
    ) -> None:
        """Writes the sky into the pixels of `rgb` (height, width, 3 or 4) whose `depth` (height, width) is 0."""
        if self._sky is None or depth.all():
            return
        rise = optical.rotation[2]
        key = rise.tobytes(), view
        if key != self._key:
            self._key, self._image = key, _image(self._sky, rise, view)
        void = depth == 0
        rgb[..., :3][void] = self._image[void]


def _image(sky: Sky, rise: NDArray[np.float64], view: Perspective) -> NDArray[np.uint8]:
    """Returns the sky (height, width, 3) in all pixels; `rise` (3,) is the world's z axis in the optical frame."""
    columns, rows = view.steps()
    across, down = columns[None, :], rows[:, None]
    sine = (rise[0] * across + rise[1] * down + rise[2]) / np.sqrt(across * across + down * down + 1.0)
    zenith, horizon, ground = (np.array(colour, np.float64) for colour in (sky.zenith, sky.horizon, sky.ground))
    above = np.sqrt(np.clip(sine, 0.0, 1.0))[..., None]
    below = np.clip(-sine / _HAZE, 0.0, 1.0)[..., None]
    return np.asarray(np.rint(horizon + above * (zenith - horizon) + below * (ground - horizon)), np.uint8)
