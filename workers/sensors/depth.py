"""Noise of depth images that are measured by triangulation: a stereo pair, or a camera and a projector.

Pure functions on images of a pinhole camera with axial depth. Renders nothing.
"""

from __future__ import annotations

import functools
from collections.abc import Iterator
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from schemas.rig.noise import StereoDepthNoise, StructuredLightNoise
from schemas.support.numpy_types import Bools, Ints, Singles
from workers.sensors.streams import LEVELS, Effect, NoiseKey, normal_of

_EDGE_PX = 1.0
"""Threshold of the second difference of the disparity over half a matching window, pixels. Above it, the window
contains an edge."""
_BAND = 64
"""Number of rows that are computed at once, so intermediate values stay in the cache of the processor. It is a multiple
of 4, because `NoiseKey.stream` requires this of the size of each part."""
_LEAST_PX = np.float32(1e-6)
"""Positive disparity that replaces disparities of 0 and less, which give no measurement, pixels."""
_BLOCK_PX, _HOLE_BLOCKS = 4, 4
"""`_BLOCK_PX` is the side of the square blocks that holes consist of, pixels. `_HOLE_BLOCKS` is the distance, in
blocks, between the random values from which the values of all blocks are interpolated."""


def noisy_depth(
    depth: Singles, noise: StereoDepthNoise | StructuredLightNoise, focal_px: float, key: NoiseKey, step: int
) -> Singles:
    """Returns the depth image that triangulation measures; 0 without a measurement.

    Args:
        depth: (H, W) distance along the optical axis, metres; 0 where no surface is visible.
        noise: parameters.
        focal_px: focal length along the rows, pixels.
        key: identity of the sensor in the episode.
        step: control step of the image.
    """
    scale = np.float32(focal_px * noise.baseline_m)
    seen = shifted(depth, noise.shift_std_px, key, step)
    exact = np.empty_like(depth) if seen is depth else seen  # reuses `seen`, because new memory takes time
    lost = np.empty(seen.shape, np.bool_)
    for rows in _bands(len(seen)):
        np.divide(scale, np.where(seen[rows] > 0, seen[rows], np.float32(np.inf)), out=exact[rows])
        lost[rows] = hidden(exact[rows], noise.second_view)
        lost[rows] |= exact[rows] > scale / np.float32(noise.range_min_m)
        lost[rows] |= exact[rows] < scale / np.float32(noise.range_max_m)
    if noise.edge_dropout:
        near_edges = np.flatnonzero(edges(exact, noise.window_px))
        is_lost = key.is_below(noise.edge_dropout, Effect.EDGE_DROPOUT, len(near_edges), step)
        lost.ravel()[near_edges[is_lost]] = True
    if noise.hole_share:
        lost |= holes(seen.shape, noise.hole_share, key, step)
    draw = key.stream(Effect.DISPARITY, step)
    for rows in _bands(len(seen)):
        measured = noisy_disparity(
            exact[rows], noise.disparity_std_px, noise.disparity_step_px, draw(exact[rows].shape)
        )
        kept = ~lost[rows] & (measured > 0)
        np.divide(scale, np.maximum(measured, _LEAST_PX, out=measured), out=exact[rows])
        exact[rows] *= kept
    return exact


def _bands(height: int) -> Iterator[slice]:
    """Yields slices of at most `_BAND` rows."""
    return (slice(first, min(first + _BAND, height)) for first in range(0, height, _BAND))


def noisy_disparity(disparity: Singles, std_px: float, step_px: float, drawn: NDArray[np.uint16]) -> Singles:
    """Returns disparities (H, W) with Gaussian noise, rounded to the resolution of the matcher, pixels.

    A disparity d = f b / z with the standard deviation s gives z a standard deviation of z^2 s / (f b) (K. Khoshelham
    and S. O. Elberink, "Accuracy and resolution of Kinect depth data for indoor mapping applications", Sensors 12(2),
    2012; A. Grunnet-Jepsen et al., "Tuning depth cameras for best performance", Intel RealSense). The rounding follows
    A. Handa et al., "A benchmark for RGB-D visual odometry, 3D reconstruction and SLAM", ICRA 2014.

    Args:
        disparity: (H, W) disparity without noise, pixels.
        std_px: standard deviation of the noise, pixels.
        step_px: resolution of the matcher, pixels; 0 does not round.
        drawn: (H, W) uniform random numbers.
    """
    values = normal_of(drawn)
    values *= np.float32(std_px)
    values += disparity
    if step_px:
        values *= np.float32(1 / step_px)
        np.rint(values, out=values)
        values *= np.float32(step_px)
    return values


def shifted(depth: Singles, std_px: float, key: NoiseKey, step: int) -> Singles:
    """Returns depth (H, W) read at randomly displaced pixels, which makes the outlines of objects rough.

    The method is described by Handa et al. 2014 and J. T. Barron and J. Malik, "Intrinsic scene properties from a
    single RGB-D image", CVPR 2013.
    The displacement is rounded to whole pixels, and the pixels at the border are displaced inwards.
    """
    if not std_px:
        return depth
    offsets, reach = _displacements(std_px, depth.shape[1])
    draw, pixels = key.stream(Effect.SHIFT, step), _inner_pixels(depth.shape, reach)
    result = np.empty_like(depth)
    for rows in _bands(len(depth)):
        depth.ravel().take(pixels[rows] + offsets.take(draw(result[rows].shape) >> 8), out=result[rows], mode="clip")
    return result


@functools.lru_cache(maxsize=16)
def _displacements(std_px: float, width: int) -> tuple[Ints, int]:
    """Returns 256 equally probable displacements, as differences of flat pixel indices, and the largest displacement
    along a row or column, pixels."""
    middles = np.arange(1 << 11, LEVELS, 1 << 12, dtype=np.uint16)
    values = np.rint(normal_of(middles) * std_px).astype(np.int64)
    return (values[:, None] * width + values).ravel(), int(values.max())


@functools.lru_cache(maxsize=16)
def _inner_pixels(shape: tuple[int, int], margin: int) -> Ints:
    """Returns the flat indices (H, W) of the nearest pixels that are not in the margin of the image."""
    rows, columns = (np.clip(np.arange(side), margin, side - 1 - margin) for side in shape)
    return rows[:, None] * shape[1] + columns


def hidden(disparity: Singles, second_view: Literal["left", "right"]) -> Bools:
    """Returns the pixels (H, W) that the second camera does not see, or that the projector does not illuminate.

    A pixel in column x has the column u = x - d in a view from the right. It is hidden if u is outside of the image,
    or if u of a pixel further to the right is the same or smaller, because that pixel is nearer (D. Scharstein
    and R. Szeliski, "A taxonomy and evaluation of dense two-frame stereo correspondence algorithms", IJCV 47, 2002).

    Args:
        disparity: (H, W) disparity d, pixels; 0 where no surface is visible.
        second_view: side on which the second camera or the projector is.
    """
    if second_view == "left":
        return hidden(disparity[:, ::-1], "right")[:, ::-1]
    width = disparity.shape[1]
    columns = (np.arange(width, dtype=np.float32) - disparity).ravel()
    is_hidden_pixel = columns < 0
    # the search starts at depth edges: a running minimum over each row took a third of the time of all depth noise
    pixels = np.flatnonzero(columns[:-1] >= columns[1:])
    pixels = pixels[(pixels + 1) % width > 0]
    nearer = columns[pixels + 1]
    # a pixel hides every pixel to its left, until one has a smaller column in the second view
    while len(pixels):
        is_hidden_pixel[pixels] = True
        has_left = pixels % width > 0
        pixels, nearer = pixels[has_left] - 1, nearer[has_left]
        is_hidden = columns[pixels] >= nearer
        pixels, nearer = pixels[is_hidden], nearer[is_hidden]
    return is_hidden_pixel.reshape(disparity.shape)


def edges(disparity: Singles, window_px: int) -> Bools:
    """Returns the pixels (H, W) whose matching window contains a depth edge.

    The disparity of a plane is linear in the image, so a second difference over half a window shows an edge and
    not a slope.
    """
    half, height = window_px // 2, len(disparity)
    is_edge = np.zeros(disparity.shape, bool)
    for rows in _bands(height):
        is_edge[rows, half:-half] = _is_bent(disparity[rows].T, half).T
    for rows in _bands(height - 2 * half):
        is_edge[half:-half][rows] |= _is_bent(disparity[rows.start : rows.stop + 2 * half], half)
    return is_edge


def _is_bent(image: Singles, half: int) -> Bools:
    """Returns the pixels (H - 2 half, W) whose second difference along the columns shows an edge."""
    bend = image[2 * half :] + image[: -2 * half]
    bend -= image[half:-half]
    bend -= image[half:-half]
    return np.asarray(np.abs(bend, out=bend) > _EDGE_PX)


def holes(shape: tuple[int, int], share: float, key: NoiseKey, step: int) -> Bools:
    """Returns an image (H, W) with random spots of about 16 pixels, as in regions without texture."""
    height, width = shape
    values = _smooth_noise((-(-height // _BLOCK_PX), -(-width // _BLOCK_PX)), key, step)
    spots = values < _hole_level(share)
    return spots.repeat(_BLOCK_PX, axis=1).repeat(_BLOCK_PX, axis=0)[:height, :width]


def _smooth_noise(shape: tuple[int, int], key: NoiseKey, step: int) -> Singles:
    """Returns (H, W) values interpolated between random numbers.

    The values are whole numbers below 2^24, so sums in float32 are exact.
    """
    height, width = shape
    coarse = key.bits(Effect.HOLES, (-(-height // _HOLE_BLOCKS) + 1, -(-width // _HOLE_BLOCKS) + 1), step) >> 8
    return _interpolated(_interpolated(coarse.astype(np.float32), height).T, width).T


def _interpolated(values: Singles, side: int) -> Singles:
    """Returns rows (side, N), interpolated between rows (M, N) that are `_HOLE_BLOCKS` rows apart.

    The values are multiplied by `_HOLE_BLOCKS`, so they stay whole numbers.
    """
    share = np.arange(_HOLE_BLOCKS, dtype=np.float32)[:, None]
    between = values[:-1, None] * (_HOLE_BLOCKS - share) + values[1:, None] * share
    return between.reshape(-1, values.shape[1])[:side]


@functools.lru_cache(maxsize=64)
def _hole_level(share: float) -> float:
    """Returns the threshold for which the given share of the values of `_smooth_noise` is below the threshold."""
    values = np.sort(_smooth_noise((512, 512), NoiseKey(0, 0, ""), 0), axis=None)
    return float(values[round(share * (values.size - 1))]) + (share == 1)
