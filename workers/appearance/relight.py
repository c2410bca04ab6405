"""Mixes the light map of an episode from the baked light and the light groups of its scene. Pure functions.

With factor 1 and the neutral colour temperatures, the mix is the baked light map, bit for bit. Uses tables and integers
where a result could depend on the processor.

Design: docs/design/rendering.md#varied-light-is-mixed-from-shares.
"""

from __future__ import annotations

import functools
import math

import numpy as np
from numpy.typing import NDArray

from schemas.appearance import LampLight, LightMix
from schemas.scene import Sky
from schemas.support.numpy_types import Singles

LAMP_K, SKY_K = 4000.0, 6500.0
"""Neutral colour temperatures of lamps and sky, kelvin: light of these temperatures keeps its compiled colour."""
_WHITE, _GAMMA = 3.0, 2.2
"""Parameters of the tone curve of light maps (`factory.scenes.light.smooth`): the light that the curve maps to 1, and
its gamma."""
_WHITE_BALANCE = 0.5
"""Share of a change of colour, measured in stops, that the white balance of the camera compensates."""
_STEPS = 8192
_MEAN_STEP = 4096.0
Rgb = tuple[float, float, float]


def mix_light(
    light_map: NDArray[np.uint8], shares: NDArray[np.uint8], mix: LightMix, exposure_stops: float = 0.0
) -> NDArray[np.uint8]:
    """Returns the light map of a mix, (H, W, 3).

    Args:
        light_map: (H, W, 3) baked light map.
        shares: (K + 1, H, W) shares of the sky and of each lamp group, which add up to 255.
        mix: light of the K groups and the sky.
        exposure_stops: exposure in addition to the automatic one, stops.
    """
    gains = [gain_of(mix.sky, SKY_K), *(gain_of(lamp, LAMP_K) for lamp in mix.lamps)]
    mixed = np.zeros(light_map.shape, np.float32)
    for share, gain in zip(shares, gains, strict=True):
        part = share.astype(np.float32)
        for channel in range(3):
            mixed[..., channel] += part * np.float32(gain[channel] / 255)
    baked = _light_of_codes()[light_map]
    mixed *= baked
    change = _mean(baked) / max(_mean(mixed), 1e-6)
    return _encode(mixed, change**mix.adaptation * 2.0**exposure_stops)


def expose(light_map: NDArray[np.uint8], stops: float) -> NDArray[np.uint8]:
    """Returns a light map with another exposure, stops."""
    return _encode(_light_of_codes()[light_map], 2.0**stops)


def expose_sky(sky: Sky, gain: Rgb) -> Sky:
    """Returns the background with its light multiplied by a factor for each channel."""

    def lit(colour: tuple[int, int, int]) -> tuple[int, int, int]:
        light = _light_of_codes()[np.array(colour, np.uint8)] * np.asarray(gain, np.float32)
        red, green, blue = _encode(light, 1.0).tolist()
        return red, green, blue

    return Sky(zenith=lit(sky.zenith), horizon=lit(sky.horizon), ground=lit(sky.ground))


def gain_of(light: LampLight, neutral_k: float) -> Rgb:
    """Returns factors of the red, green and blue light of a lamp; its luminance changes by the factor `light.gain`."""
    now, then = _planckian(light.temperature_k), _planckian(neutral_k)
    red, green, blue = (light.gain * (a / b) ** (1 - _WHITE_BALANCE) for a, b in zip(now, then, strict=True))
    return red, green, blue


def _planckian(kelvin: float) -> Rgb:
    """Returns linear sRGB of luminance 1 of a black body, limited to the gamut.

    Source: B. Kim et al., "Design of advanced color temperature control system for HDTV applications", Journal of the
    Korean Physical Society 41(6), 2002.
    """
    t = 1e3 / min(max(kelvin, 1667.0), 25_000.0)
    x = ((-0.2661239 * t - 0.2343589) * t + 0.8776956) * t + 0.179910
    if kelvin > 4000:
        x = ((-3.0258469 * t + 2.1070379) * t + 0.2226347) * t + 0.240390
    if kelvin <= 2222:
        y = ((-1.1063814 * x - 1.34811020) * x + 2.18555832) * x - 0.20219683
    elif kelvin <= 4000:
        y = ((-0.9549476 * x - 1.37418593) * x + 2.09137015) * x - 0.16748867
    else:
        y = ((3.0817580 * x - 5.87338670) * x + 3.75112997) * x - 0.37001483
    big_x, big_z = x / y, (1 - x - y) / y
    red = 3.2404542 * big_x - 1.5371385 - 0.4985314 * big_z
    green = -0.9692660 * big_x + 1.8760108 + 0.0415560 * big_z
    blue = 0.0556434 * big_x - 0.2040259 + 1.0572252 * big_z
    return max(red, 0.05), max(green, 0.05), max(blue, 0.05)


def _mean(light: Singles) -> float:
    """Returns the mean light; it sums integer steps of 1 / 4096, so the order of the summands has no effect."""
    steps = (np.minimum(light, np.float32(_WHITE)) * np.float32(_MEAN_STEP)).astype(np.int64)
    return int(steps.sum()) / steps.size / _MEAN_STEP


def _encode(light: Singles, exposure: float) -> NDArray[np.uint8]:
    """Returns the 8-bit codes of light, from a table whose index is proportional to the square root of the light."""
    steps = np.sqrt(np.minimum(light * np.float32(exposure / _WHITE), np.float32(1.0)))
    return np.asarray(_codes_of_steps()[(steps * np.float32(_STEPS) + np.float32(0.5)).astype(np.int32)], np.uint8)


@functools.cache
def _light_of_codes() -> Singles:
    """Returns the light (256,) of the codes: the inverse of the tone curve."""
    lights = []
    for code in range(256):
        shown = (code / 255) ** _GAMMA
        # shown = b (1 + b / w^2) / (1 + b) is a quadratic equation in the light b
        half = (1 - shown) * _WHITE**2 / 2
        lights.append(math.sqrt(half * half + shown * _WHITE**2) - half)
    return np.array(lights, np.float32)


@functools.cache
def _codes_of_steps() -> NDArray[np.uint8]:
    codes = []
    for step in range(_STEPS + 1):
        light = _WHITE * (step / _STEPS) ** 2
        codes.append(round(255 * (light * (1 + light / _WHITE**2) / (1 + light)) ** (1 / _GAMMA)))
    return np.array(codes, np.uint8)
