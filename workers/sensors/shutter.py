"""Motion blur and rolling shutter: the images at several poses during an exposure, mixed in linear light.

Computes the times at which to render, and mixes the images. Renders nothing.
"""

from __future__ import annotations

import functools

import numpy as np
from numpy.typing import NDArray

from schemas.rig.noise import ColourNoise
from schemas.support.numpy_types import Floats, Singles
from workers.sensors.colour import codes_of, linear_of_codes

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
