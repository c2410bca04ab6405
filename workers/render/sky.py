"""Paints the sky of an open scene into the pixels without a surface: the same bytes for all renderers.

Does not change depth or ids.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from schemas.config import CameraConfig
from schemas.scene import Sky
from workers.geometry.camera import OpticalPose, intrinsics

_HAZE = 0.08
"""Sine of the angle below the horizon at which the ground is free of haze."""


class SkyPainter:
    """Painter of one sky for one camera; keeps the last image, because most poses have the same lean."""

    def __init__(self, sky: Sky | None, camera: CameraConfig) -> None:
        """Prepares the painter; `None` leaves frames as they are."""
        self._sky = sky
        self._camera = camera
        self._key = b""
        self._image = np.empty((0, 0, 3), np.uint8)

    def paint(self, rgb: NDArray[np.uint8], depth: NDArray[np.float32], optical: OpticalPose) -> None:
        """Writes the sky into the pixels of `rgb` (size, size, 3) whose `depth` (size, size) is 0."""
        if self._sky is None or depth.all():
            return
        rise, size = optical.rotation[2], len(rgb)
        key = rise.tobytes()
        if key != self._key or len(self._image) != size:
            self._key, self._image = key, _image(self._sky, rise, self._camera, size)
        void = depth == 0
        rgb[void] = self._image[void]


def _image(sky: Sky, rise: NDArray[np.float64], camera: CameraConfig, size: int) -> NDArray[np.uint8]:
    """Returns (size, size, 3) the sky in all pixels; `rise` (3,) is the height gained along each optical axis."""
    focal = intrinsics(camera, size)[0, 0]
    steps = (np.arange(size) + 0.5 - size / 2) / focal
    across, down = steps[None, :], steps[:, None]
    sine = (rise[0] * across + rise[1] * down + rise[2]) / np.sqrt(across * across + down * down + 1.0)
    zenith, horizon, ground = (np.array(colour, np.float64) for colour in (sky.zenith, sky.horizon, sky.ground))
    above = np.sqrt(np.clip(sine, 0.0, 1.0))[..., None]
    below = np.clip(-sine / _HAZE, 0.0, 1.0)[..., None]
    return np.asarray(np.rint(horizon + above * (zenith - horizon) + below * (ground - horizon)), np.uint8)
