"""Noise of camera images: exposure, white balance, shot and read noise, JPEG, depth, motion blur, rolling shutter.

Pure functions. Computes the times at which to render; renders nothing.
"""

from __future__ import annotations

import functools
import io

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from schemas.rig.cameras import Camera, PinholeCamera
from schemas.rig.noise import ColourNoise
from schemas.support.numpy_types import Floats, Ints, Singles
from workers.sensors.depth import noisy_depth
from workers.sensors.streams import LEVELS, Effect, NoiseKey, normal_of


def colour_steps(camera: Camera, step: int, control_hz: int) -> Floats:
    """Returns the times (K,) at which to render the images for `sense_colour`, control steps, none after `step`.

    The poses at these times are those of `workers.sensors.frames.poses_at`.
    """
    noise = camera.noise.colour if camera.noise else None
    return step + (np.zeros(1) if noise is None else shutter_offsets(noise, control_hz))


def sense_colour(camera: Camera, images: NDArray[np.uint8], key: NoiseKey, step: int) -> NDArray[np.uint8]:
    """Returns the colour image (H, W, 3), sRGB, that the camera records.

    Args:
        camera: model of the camera.
        images: (K, H, W, 3) sRGB images without noise at the times of `colour_steps`.
        key: identity of the camera in the episode, which determines the noise.
        step: control step of the image.
    """
    noise = camera.noise.colour if camera.noise else None
    return images[-1] if noise is None else noisy_colour(exposed(images, noise), noise, key, step)


def sense_depth(camera: Camera, depth: Singles, key: NoiseKey, step: int) -> Singles:
    """Returns the depth image (H, W) that the camera measures, metres; 0 without a measurement.

    Args:
        camera: model of the camera.
        depth: (H, W) depth without noise, metres; 0 where no surface is visible.
        key: identity of the camera in the episode, which determines the noise.
        step: control step of the image.
    """
    noise = camera.noise.depth if camera.noise else None
    if noise is None:
        return depth
    assert isinstance(camera, PinholeCamera), "the model of the camera has been validated"
    return noisy_depth(depth, noise, focal_px=camera.focal_px[0], key=key, step=step)


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


_LIGHT_LEVELS = 1 << 16


def shutter_offsets(noise: ColourNoise, control_hz: int) -> Floats:
    """Returns the times (K,) of the images that are mixed into one image, in control steps relative to it, at most 0.

    Without motion blur and rolling shutter, the only time is 0. The exposure of the last row ends at the control step
    itself, so an image does not depend on later poses.
    """
    duration = noise.motion_blur_s + noise.rolling_shutter_s
    if not duration:
        return np.zeros(1)
    bins = np.arange(noise.shutter_images) + 0.5
    return (bins / noise.shutter_images - 1) * duration * control_hz


@functools.lru_cache(maxsize=16)
def row_weights(noise: ColourNoise, rows: int) -> Singles:
    """Returns the weights (K, rows) of the images in each row; the weights of a row add up to 1.

    A row is exposed for `motion_blur_s`, and each row begins later than the one above it (C. Geyer, M. Meingast and S.
    Sastry, "Geometric models of rolling-shutter cameras", OMNIVIS 2005). The duration of the
    image is divided into K equal parts; the weight of image k is the share of the row's exposure within part k.
    """
    count = noise.shutter_images
    duration = noise.motion_blur_s + noise.rolling_shutter_s
    begin = noise.rolling_shutter_s / duration * np.arange(rows) / max(rows - 1, 1)
    end = begin + max(noise.motion_blur_s / duration, 1e-6)
    edges = np.arange(count + 1)[:, None] / count
    edges[-1] = 2.0
    weights = np.diff(np.clip(edges, begin, end), axis=0)
    return np.asarray(weights / weights.sum(axis=0), np.float32)


def exposed(images: NDArray[np.uint8], noise: ColourNoise) -> NDArray[np.uint8]:
    """Returns the image (H, W, 3), sRGB, of an exposure during which the camera moves.

    Args:
        images: (K, H, W, 3) sRGB images at the times of `shutter_offsets`.
        noise: parameters.
    """
    if len(images) == 1:
        return np.asarray(images[0])
    # several images, because one image that is warped by optical flow is wrong where surfaces appear
    light = (linear_of_codes() * (_LIGHT_LEVELS - 1)).astype(np.float32)
    total = np.zeros(images.shape[1:], np.float32)
    for image, weights in zip(images, row_weights(noise, images.shape[1]), strict=True):
        rows = np.flatnonzero(weights)
        part = slice(rows[0], rows[-1] + 1) if len(rows) else slice(0)
        total[part] += light.take(image[part]) * weights[part, None, None]
    return _codes_of_levels().take(np.rint(total).astype(np.uint16))


@functools.cache
def _codes_of_levels() -> NDArray[np.uint8]:
    return codes_of(np.arange(_LIGHT_LEVELS) / (_LIGHT_LEVELS - 1)).astype(np.uint8)
