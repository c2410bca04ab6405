"""Converts colours between sRGB, linear light and CIELAB, and assigns basic colour names.

The eleven names are those of Berlin and Kay (Basic Color Terms, 1969). Their sectors of lightness, chroma and hue
follow the XKCD colour survey (Munroe 2010, blog.xkcd.com/2010/05/03/color-survey-results).
Pure functions. Does not choose the surfaces to sample.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from schemas.support.numpy_types import Floats
from schemas.terms import COLOUR_NAMES

_BLACK, _GRAY, _WHITE, _RED, _ORANGE, _YELLOW, _GREEN, _BLUE, _PURPLE, _PINK, _BROWN = range(11)
_HUES = ((0, 45, _RED), (45, 72, _ORANGE), (72, 108, _YELLOW), (108, 195, _GREEN), (195, 308, _BLUE))
_NAMELESS = len(COLOUR_NAMES)
_TEAL = (183.0, 217.0)
"""Ambiguous hues between green and blue, degrees; samples in this range count for neither colour."""
_LATE_HUES = ((308, 342, _PURPLE), (342, 361, _RED))

_TO_XYZ = np.array(
    [[0.4124564, 0.3575761, 0.1804375], [0.2126729, 0.7151522, 0.0721750], [0.0193339, 0.1191920, 0.9503041]]
)
_D65 = np.array([0.95047, 1.0, 1.08883])
MIN_SHARE = 0.5
"""Smallest share of the votes with which a colour name can be dominant."""
MAX_RIVAL = 0.36
"""Share of the votes from which the second most frequent name makes the colour ambiguous, so no name is dominant."""
# without this limit, a table with a brown top on a white frame was called white
_NEUTRALS = [_BLACK, _GRAY, _WHITE]
_NEUTRAL_VOTE = 0.5
"""Votes of a black, gray or white sample; any other sample has one vote. So a blue chair on a black base is called
blue."""
_BLACK_BELOW = 30.0
"""Lightness below which an achromatic colour is called black. It includes charcoal, which looks black indoors."""
_BLACKISH = 7.0
"""Chroma below which a dark colour is called black. A dark colour with a chroma from this value to 12 has no name; one
with a larger chroma, such as navy, has the name of its hue."""


def linear_of(srgb: ArrayLike) -> Floats:
    """Returns linear light of sRGB values 0..1 (IEC 61966-2-1)."""
    c = np.asarray(srgb, float)
    curved: Floats = ((np.maximum(c, 0.0) + 0.055) / 1.055) ** 2.4
    return np.where(c <= 0.04045, c / 12.92, curved)


def srgb_of(linear: ArrayLike) -> Floats:
    """Returns sRGB values 0..1 of linear light; values out of range are clipped."""
    c = np.clip(np.asarray(linear, float), 0.0, 1.0)
    curved: Floats = 1.055 * c ** (1 / 2.4) - 0.055
    return np.where(c <= 0.0031308, 12.92 * c, curved)


def lab_of(srgb: ArrayLike) -> Floats:
    """Returns CIELAB (..., 3) of sRGB values 0..1 under D65 (CIE 15:2004)."""
    xyz = linear_of(srgb) @ _TO_XYZ.T / _D65
    f = np.where(xyz > 216 / 24389, np.cbrt(xyz), (24389 / 27 * xyz + 16) / 116)
    x, y, z = f[..., 0], f[..., 1], f[..., 2]
    return np.stack([116 * y - 16, 500 * (x - y), 200 * (y - z)], axis=-1)


def name_indices(srgb: ArrayLike) -> NDArray[np.int64]:
    """Returns the indices (...) in `COLOUR_NAMES` of the names of sRGB values (..., 3), 0..1.

    A name applies to sectors of lightness, chroma and hue. Ambiguous colours have the index after the last name.
    """
    lab = lab_of(srgb)
    lightness, chroma = lab[..., 0], np.hypot(lab[..., 1], lab[..., 2])
    hue = np.degrees(np.arctan2(lab[..., 2], lab[..., 1])) % 360
    names = np.full(lightness.shape, _RED, np.int64)
    for first, last, name in _HUES + _LATE_HUES:
        names[(hue >= first) & (hue < last)] = name
    names[(hue >= _TEAL[0]) & (hue < _TEAL[1])] = _NAMELESS
    names[_is_pink(lightness, hue)] = _PINK
    names[_is_brown(lightness, chroma, hue)] = _BROWN
    names[(hue >= 50) & (hue < 125) & (lightness >= 85) & (chroma < 24)] = _WHITE
    plain = chroma < np.where(lightness > 75, 9, 12)
    names[plain] = np.where(lightness[plain] < 85, _GRAY, _WHITE)
    dark = plain & (lightness < _BLACK_BELOW)
    names[dark] = np.where(chroma[dark] < _BLACKISH, _BLACK, _NAMELESS)
    return names


def _is_pink(lightness: Floats, hue: Floats) -> NDArray[np.bool_]:
    """Returns whether colours are pink: light red, or bluish red of at least medium lightness."""
    bluish = ((hue >= 330) | (hue < 20)) & (lightness >= 50)
    return np.asarray(bluish | ((hue < 45) & (lightness > 68)))


def _is_brown(lightness: Floats, chroma: Floats, hue: Floats) -> NDArray[np.bool_]:
    """Returns whether colours are brown: dark or dull orange, dull red, and the dull yellow of wood and cardboard."""
    is_vivid = (lightness >= 50) & (chroma >= 58)  # not brown; for example the shadows on orange cloth
    orange = (hue >= 48) & (hue < 72) & ~is_vivid & ((lightness < 58) | (chroma < 45))
    red = (hue >= 28) & (hue < 48) & (chroma < 38) & (lightness < 60)
    yellow = (hue >= 72) & (hue < 98) & ((lightness < 58) | ((lightness < 88) & (chroma < 45)))
    return np.asarray(orange | red | yellow)


def dominant_name(srgb: ArrayLike) -> str:
    """Returns the colour name that dominates the samples (`MIN_SHARE`, `MAX_RIVAL`), or `unknown`.

    Args:
        srgb: samples (N, 3), 0..1; each sample is one vote, but an achromatic sample is half a vote.
    """
    names = name_indices(srgb)
    if names.size == 0:
        return "unknown"
    votes = np.bincount(names.ravel(), minlength=_NAMELESS + 1).astype(float)
    votes[_NEUTRALS] *= _NEUTRAL_VOTE
    votes /= votes.sum()
    rival, winner = np.argsort(votes, kind="stable")[-2:]
    is_clear = winner != _NAMELESS and votes[winner] >= MIN_SHARE and votes[rival] < MAX_RIVAL
    return COLOUR_NAMES[winner] if is_clear else "unknown"
