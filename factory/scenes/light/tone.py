"""Tone-maps light to image values: exposure by scene content, soft shoulder, warm and cool white. Pure functions.

The curve applies to the light map alone, so rendering is one multiplication and cannot overflow.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from schemas.support.numpy_types import Floats

SKY_SHARE, FLOOR = 0.42, 0.03
CONTACT = 2.0
"""Exponent of the openness in ambient light; above 1, corners and floor under furniture are darker than is physically
correct."""
SHELTER = 0.6
"""Exponent of the openness in lamp light, where the openness adds soft contact shadows."""
_EXPOSURE = 1.3
"""Mean light before the tone curve, for a scene whose exposure is not corrected; in the unit of `WHITE`."""
_GREY, _ADAPTATION = 0.38, 0.6
"""`_GREY` is the mean reflectance of a scene whose exposure is not corrected. For other scenes, the exposure is
multiplied by (`_GREY` / mean reflectance) to the power of `_ADAPTATION`, within limits."""
_MOST_CORRECTION = 1.35
WHITE = 3.0
"""Light that the tone curve maps to 1; brighter light is clipped."""
_LAMP_TINT = np.array((1.0, 0.965, 0.885))
_SKY_TINT = np.array((0.94, 0.975, 1.0))
GAMMA = 2.2


def tone(sky: Floats, direct: Floats, measured: NDArray[np.bool_], grey: Floats) -> NDArray[np.uint8]:
    """Returns the gamma-encoded light map (H, W, 3).

    Args:
        sky: (H, W) openness, 0..1.
        direct: (H, W) lamp light, any unit.
        measured: (H, W) mask of the texels that determine the exposure.
        grey: (H, W) reflectance of the surface, 0..1.
    """
    lit = measured & (direct > 0)
    mean = float(direct[lit].mean()) if lit.any() else 1.0
    open_, lamps = sky, direct / mean
    ambient = FLOOR + SKY_SHARE * open_[..., None] ** CONTACT * _SKY_TINT
    light = ambient + (1 - SKY_SHARE) * (lamps * open_**SHELTER)[..., None] * _LAMP_TINT
    exposed = float(light[lit].mean()) if lit.any() else 1.0
    scale = _EXPOSURE * _correction(grey[lit]) / exposed
    bright = np.minimum(light * scale, WHITE)
    shown = bright * (1 + bright / WHITE**2) / (1 + bright)
    return np.asarray(np.rint(255 * shown ** (1 / GAMMA)), np.uint8)


def _correction(grey: Floats) -> float:
    """Returns the exposure factor: above 1 for dark scenes, below 1 for light ones."""
    if not len(grey):
        return 1.0
    wanted = (_GREY / max(float(grey.mean()), 1e-3)) ** _ADAPTATION
    return float(np.clip(wanted, 1 / _MOST_CORRECTION, _MOST_CORRECTION))
