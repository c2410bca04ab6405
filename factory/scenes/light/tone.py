"""From light to picture values: exposure by the scene's own mean, a soft shoulder, a warm and a cool white; pure.

The curve works on the light alone, so that drawing a frame is one multiplication and nothing can overflow.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

__all__ = ["tone"]

_SKY_SHARE, _FLOOR = 0.5, 0.04
_CONTACT = 2.0
"""Power of the openness: above one, corners and the floor under furniture darken more than physics would have it."""
_EXPOSURE = 1.45
"""Where the mean light lies before the shoulder, in units of the light that comes out as a half."""
_WHITE = 3.0
"""Light, in the same units, that comes out as full."""
_LAMP_TINT = np.array((1.0, 0.97, 0.90))
_SKY_TINT = np.array((0.96, 0.98, 1.0))
_GAMMA = 2.2

Floats = NDArray[np.float64]


def tone(sky: Floats, direct: Floats, measured: NDArray[np.bool_]) -> NDArray[np.uint8]:
    """Returns the picture (H, W, 3), gamma-encoded.

    Args:
        sky: (H, W) openness, 0..1.
        direct: (H, W) light of lamps, any unit.
        measured: (H, W) the texels that set the exposure.
    """
    ambient = _FLOOR + _SKY_SHARE * sky[..., None] ** _CONTACT * _SKY_TINT
    lit = measured & (direct > 0)
    mean = float(direct[lit].mean()) if lit.any() else 1.0
    light = ambient + (1 - _SKY_SHARE) * direct[..., None] / mean * _LAMP_TINT
    scale = _EXPOSURE / float(light[lit].mean()) if lit.any() else _EXPOSURE
    bright = np.minimum(light * scale, _WHITE)
    shown = bright * (1 + bright / _WHITE**2) / (1 + bright)
    return np.asarray(np.rint(255 * shown ** (1 / _GAMMA)), np.uint8)
