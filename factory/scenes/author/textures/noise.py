"""Seamless noise and shading for procedural textures of 512 x 512 pixels.

Pure functions. Does not draw whole textures.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
from numpy.random import Generator

from schemas.support.numpy_types import Floats

TEXTURE_SIZE = 512
Pixels = npt.NDArray[np.uint8]


def clouds(rng: Generator, falloff: float, stretch: float = 1.0) -> Floats:
    """Returns seamless noise with zero mean and unit standard deviation; `stretch` > 1 elongates it along u."""
    white = np.fft.rfft2(rng.standard_normal((TEXTURE_SIZE, TEXTURE_SIZE)))
    down = np.fft.fftfreq(TEXTURE_SIZE)[:, None] * TEXTURE_SIZE
    across = np.fft.rfftfreq(TEXTURE_SIZE)[None] * TEXTURE_SIZE * stretch
    frequency = np.maximum(np.hypot(down, across), 1.0)
    noise = np.fft.irfft2(white / frequency**falloff, s=(TEXTURE_SIZE, TEXTURE_SIZE))
    noise -= noise.mean()
    return np.asarray(noise / noise.std())


def shade(base: str, tone: Floats) -> Pixels:
    """Multiplies an sRGB base colour by a tone field around 1."""
    colour = np.array([int(base[start : start + 2], 16) for start in (1, 3, 5)], dtype=np.float64)
    return np.clip(tone[..., None] * colour, 0, 255).astype(np.uint8)


def grid() -> tuple[Floats, Floats]:
    """Returns the row and the column of each pixel, (512, 512) each."""
    line = np.arange(TEXTURE_SIZE, dtype=np.float64)
    rows, columns = np.meshgrid(line, line, indexing="ij")
    return rows, columns
