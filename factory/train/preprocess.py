"""Converts frames to network input: downscaled colour and depth; augments training batches with matching labels.

Pure functions, which the cache and the policy share, so equal frames give identical input in training and driving.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from factory.dataset.rendering import mean_of_blocks, middle_of_blocks

FAR_M = 10.0
"""Maximum depth, metres. Larger depths, and 0 (the ray hits nothing), are set to this value."""
_MM_PER_M = 1000.0
_BRIGHTNESS, _CONTRAST, _TINT = 0.25, 0.2, 0.08
"""Half widths of the ranges of an offset of all channels, of the gain, and of an offset of each channel. Offsets refer
to channels in -1..1: 0.25 is 32 of 255 levels, 0.08 is 10."""
# the baselines (docs/training/baselines.md) were trained with these values; no ablation of them is recorded
_CLOSER = 0.75
"""Smallest factor by which a zoom scales distances: a view from 1 m then looks like a view from 0.75 m."""
_ENLARGED = 0.6
"""Share of the stop frames that are zoomed."""


def shrink_rgb(rgb: NDArray[np.uint8], size: int) -> NDArray[np.uint8]:
    """Returns the mean colour of each pixel block, (size, size, 3).

    Args:
        rgb: (S, S, 3) sRGB; S is a multiple of `size`.
        size: Width and height, pixels.
    """
    return mean_of_blocks(rgb, len(rgb) // size)


def shrink_depth(depth: NDArray[np.float32], size: int) -> NDArray[np.uint16]:
    """Returns the depth at the centre of each block, (size, size) millimetres, at most `FAR_M`.

    Args:
        depth: (S, S) metres along the optical axis; S is a multiple of `size`.
        size: Width and height, pixels.
    """
    middle = middle_of_blocks(depth, len(depth) // size)
    metres = np.where((middle <= 0) | (middle > FAR_M), FAR_M, middle)
    return np.rint(metres * _MM_PER_M).astype(np.uint16)


def shrink_mask(ids: NDArray[np.uint16], instance_id: int, size: int) -> NDArray[np.uint8]:
    """Returns the share of each block that shows an instance, (size, size), 0..255. Used for training only."""
    block = len(ids) // size
    hits = (ids == instance_id).reshape(size, block, size, block).mean(axis=(1, 3))
    shares: NDArray[np.uint8] = np.rint(hits * 255).astype(np.uint8)
    return shares


def to_input(rgb: NDArray[np.uint8], depth: NDArray[np.uint16]) -> NDArray[np.float32]:
    """Returns the network input (N, 4, S, S): colour and nearness channels, each about -1..1.

    Args:
        rgb: (N, S, S, 3) downscaled colour.
        depth: (N, S, S) downscaled depth, millimetres. Nearness is logarithmic, which gives more resolution to the last
            metre, where the robot stops.
    """
    colours = rgb.transpose(0, 3, 1, 2).astype(np.float32) / 127.5 - 1.0
    metres = np.clip(depth.astype(np.float32) / _MM_PER_M, 0.1, FAR_M)
    nearness = 1.0 - np.log(metres / 0.1) / np.float32(np.log(FAR_M / 0.1) / 2)
    return np.ascontiguousarray(np.concatenate([colours, nearness[:, None]], axis=1), np.float32)


class Batch(NamedTuple):
    """Batch of network inputs and labels."""

    pictures: NDArray[np.float32]
    """(N, 4, S, S) colour and nearness channels, about -1..1."""
    mask: NDArray[np.float32]
    """(N, S/8, S/8) share of each cell that shows the target, 0..1."""
    actions: NDArray[np.float32]
    """(N, 2) action labels: v in m/s, w in rad/s."""
    is_stop: NDArray[np.bool_]
    """(N,) whether the label is a stop."""
    has_stop: NDArray[np.bool_]
    """(N,) whether `is_stop` is a label."""
    has_twist: NDArray[np.bool_]
    """(N,) whether `actions` is a label."""
    goal: NDArray[np.float32]
    """(N, 2) distance to the target, metres, and its bearing, radians; NaN without a goal."""
    words: NDArray[np.int64]
    """(N, W) token indices of the instructions."""


def augment(batch: Batch, rng: np.random.Generator, mirrored_words: NDArray[np.int64]) -> Batch:
    """Returns the frames with random changes: mirroring, brightness, contrast, and the zoom of some stop frames.

    In the instruction of a mirrored frame, left and right are swapped.

    The expert stops on the success circle, so no recorded frame shows the view of a robot that is too close. A zoomed
    stop frame, with its depths scaled by the same factor, approximates such a view. Its label remains a stop.

    Args:
        batch: Frames, which are not changed.
        rng: Random generator.
        mirrored_words: (V,) index of each word in the instruction of a mirrored frame.
    """
    pictures, mask = batch.pictures.copy(), batch.mask.copy()
    actions, goal = batch.actions.copy(), batch.goal.copy()
    for row in np.flatnonzero(batch.is_stop & (rng.random(len(mask)) < _ENLARGED)):
        share = float(rng.uniform(_CLOSER, 1.0))
        pictures[row], mask[row] = _enlarge(pictures[row], share), _enlarge(mask[row][None], share)[0]
        pictures[row, 3] = _shorten(pictures[row, 3], share)
        goal[row, 0] *= share
    mirrored = rng.random(len(mask)) < 0.5
    pictures[mirrored], mask[mirrored] = pictures[mirrored, :, :, ::-1], mask[mirrored, :, ::-1]
    actions[mirrored, 1] *= -1
    goal[mirrored, 1] *= -1
    words = np.where(mirrored[:, None], mirrored_words[batch.words], batch.words)
    shape = (len(mask), 1, 1, 1)
    gain = rng.uniform(1 - _CONTRAST, 1 + _CONTRAST, shape)
    lift = rng.uniform(-_BRIGHTNESS, _BRIGHTNESS, shape) + rng.uniform(-_TINT, _TINT, (len(mask), 3, 1, 1))
    pictures[:, :3] = np.clip(pictures[:, :3] * gain + lift, -1, 1)
    return batch._replace(pictures=pictures, mask=mask, actions=actions, goal=goal, words=words)


def _enlarge(picture: NDArray[np.float32], share: float) -> NDArray[np.float32]:
    """Returns the central part of a (C, S, S) picture at full size, by nearest-neighbour sampling."""
    size = picture.shape[1]
    places = np.clip(((np.arange(size) + 0.5 - size / 2) * share + size / 2).astype(np.int64), 0, size - 1)
    return picture[:, places[:, None], places[None, :]]


def _shorten(nearness: NDArray[np.float32], share: float) -> NDArray[np.float32]:
    """Returns the nearness after scaling the depths by `share`: a shift, because nearness is logarithmic."""
    shortened: NDArray[np.float32] = np.clip(nearness - np.float32(2 * np.log(share) / np.log(100.0)), -1, 1)
    return shortened
