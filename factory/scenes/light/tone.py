"""From light to picture values: exposure by what the scene would show, a soft shoulder, a warm and a cool white; pure.

The curve works on the light alone, so that drawing a frame is one multiplication and nothing can overflow.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from schemas.support.numpy_types import Floats

__all__ = ["tone"]

_SKY_SHARE, _FLOOR = 0.42, 0.03
_CONTACT = 2.0
"""Power of the openness: above one, corners and the floor under furniture darken more than physics would have it."""
_SHELTER = 0.6
"""Power of the openness that dims lamps too: what stands on the floor is tied to it by a soft dark rim."""
_EXPOSURE = 1.3
"""Where the mean light lies before the shoulder, in units of the light that comes out as a half."""
_GREY, _ADAPTION = 0.38, 0.6
"""Reflectance that is shown at that exposure, and the power by which lighter and darker scenes are corrected."""
_MOST_CORRECTION = 1.35
_WHITE = 3.0
"""Light, in the same units, that comes out as full."""
_LAMP_TINT = np.array((1.0, 0.965, 0.885))
_SKY_TINT = np.array((0.94, 0.975, 1.0))
_GAMMA = 2.2


def tone(sky: Floats, direct: Floats, measured: NDArray[np.bool_], grey: Floats) -> NDArray[np.uint8]:
    """Returns the picture (H, W, 3), gamma-encoded.

    Args:
        sky: (H, W) openness, 0..1.
        direct: (H, W) light of lamps, any unit.
        measured: (H, W) the texels that set the exposure.
        grey: (H, W) the reflectance of what lies there, 0..1.
    """
    lit = measured & (direct > 0)
    mean = float(direct[lit].mean()) if lit.any() else 1.0
    open_, lamps = sky, direct / mean
    ambient = _FLOOR + _SKY_SHARE * open_[..., None] ** _CONTACT * _SKY_TINT
    light = ambient + (1 - _SKY_SHARE) * (lamps * open_**_SHELTER)[..., None] * _LAMP_TINT
    exposed = float(light[lit].mean()) if lit.any() else 1.0
    scale = _EXPOSURE * _correction(grey[lit]) / exposed
    bright = np.minimum(light * scale, _WHITE)
    shown = bright * (1 + bright / _WHITE**2) / (1 + bright)
    return np.asarray(np.rint(255 * shown ** (1 / _GAMMA)), np.uint8)


def _correction(grey: Floats) -> float:
    """More light for dark places and less for light ones, as a camera does it."""
    if not len(grey):
        return 1.0
    wanted = (_GREY / max(float(grey.mean()), 1e-3)) ** _ADAPTION
    return float(np.clip(wanted, 1 / _MOST_CORRECTION, _MOST_CORRECTION))
