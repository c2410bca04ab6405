"""Noise and processing of colour images: exposure, white balance, shot and read noise, JPEG.

Pure functions on sRGB images. The motion of the camera is in `workers.sensors.shutter`.
"""

from __future__ import annotations

import functools
import io

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from schemas.rig.noise import ColourNoise
from schemas.support.numpy_types import Floats, Ints
from workers.sensors.streams import LEVELS, Effect, NoiseKey, normal_of

_CODES = 256
"""Number of values of a colour channel."""
_KEPT_TABLES = 64


def noisy_colour(rgb: NDArray[np.uint8], noise: ColourNoise, key: NoiseKey, step: int) -> NDArray[np.uint8]:
    """Returns the image (H, W, 3) that a camera records, sRGB.

    Args:
        rgb: (H, W, 3) image without noise, sRGB.
        noise: parameters.
        key: identity of the sensor in the episode.
        step: control step of the image.
    """
    numbers = rgb.astype(np.uint16)
    numbers <<= 8
    numbers |= key.bits(Effect.ELECTRONS, -(-rgb.size // 2), step).view(np.uint8)[: rgb.size].reshape(rgb.shape)
    image = np.empty_like(rgb)
    for channel, gain in enumerate(channel_gains(noise, key)):
        image[..., channel] = _recorded(noise, gain).take(numbers[..., channel], mode="clip")
    return image if noise.jpeg_quality is None else compressed(image, noise.jpeg_quality)


def channel_gains(noise: ColourNoise, key: NoiseKey) -> tuple[float, float, float]:
    """Returns the gains of red, green and blue in an episode: its exposure times its white balance.

    Exposure and the balance of red and blue have a logarithmic normal distribution, because an error of the exposure or
    of the colour temperature multiplies the signal.
    """
    stops = noise.exposure_stops + noise.exposure_std_stops * float(key.normals(Effect.EXPOSURE, 1)[0])
    red, blue = noise.white_balance_std_stops * key.normals(Effect.WHITE_BALANCE, 2).astype(float)
    drawn = (2**stops * gain * 2**shift for gain, shift in zip(noise.white_balance, (red, 0.0, blue), strict=True))
    red_gain, green_gain, blue_gain = map(float, drawn)
    return red_gain, green_gain, blue_gain


@functools.lru_cache(maxsize=_KEPT_TABLES)
def _recorded(noise: ColourNoise, gain: float) -> NDArray[np.uint8]:
    """Returns a table (65536,) of recorded codes; its index is 256 times the code without noise plus a random byte.

    Uses the linear camera model of EMVA Standard 1288, release 4.0, Sec. 2: the variance of the electrons is their
    number (shot noise) plus the square of the read noise.
    """
    white = noise.full_well_e / 10 ** (noise.gain_db / 20)
    electrons = white * gain * linear_of_codes()
    spread = np.sqrt(electrons + noise.read_noise_e**2) * noise.has_electrons
    middles = np.arange(1 << 7, LEVELS, 1 << 8, dtype=np.uint16)
    light = (electrons[:, None] + spread[:, None] * normal_of(middles).astype(np.float64)) / white
    return codes_of(light).astype(np.uint8).ravel()


@functools.cache
def linear_of_codes() -> Floats:
    """Returns the light (256,) of each sRGB code, 0 to 1 (IEC 61966-2-1)."""
    return np.array([_light(code / (_CODES - 1)) for code in range(_CODES)])


def codes_of(light: Floats) -> Ints:
    """Returns the sRGB codes of light of any shape; values below 0 and above 1 are clipped."""
    middles = np.array([_light((code + 0.5) / (_CODES - 1)) for code in range(_CODES - 1)])
    return np.searchsorted(middles, light, side="right")


def _light(value: float) -> float:
    return value / 12.92 if value <= 0.04045 else ((value + 0.055) / 1.055) ** 2.4


def compressed(rgb: NDArray[np.uint8], quality: int) -> NDArray[np.uint8]:
    """Returns the image after JPEG compression with a quality of 1 to 100, chroma subsampled 4:2:0."""
    file = io.BytesIO()
    Image.fromarray(rgb).save(file, "JPEG", quality=quality, subsampling="4:2:0")
    with Image.open(file) as image:
        return np.array(image)
