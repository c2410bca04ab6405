"""Preprocessing of frames for the network: sizes, ranges, and preserved geometry."""

from __future__ import annotations

import numpy as np
import pytest

from factory.train.input_size import SIZES
from factory.train.preprocess import FAR_M, Batch, augment, shrink_depth, shrink_mask, shrink_rgb, to_input
from schemas.encoding.image_sizes import FRAME_SIZE_PX

SWAPPED = np.array((0, 1, 2, 4, 3), np.int64)
"""Word ids for a mirrored image: the ids 3 and 4, which name opposite sides, are swapped."""


@pytest.mark.parametrize("size", SIZES)
def test_colours_are_the_mean_of_their_block(size: int) -> None:
    rgb = np.zeros((FRAME_SIZE_PX, FRAME_SIZE_PX, 3), np.uint8)
    block = FRAME_SIZE_PX // size
    rgb[:block, :block] = (200, 100, 50)
    small = shrink_rgb(rgb, size)
    assert small.shape == (size, size, 3)
    assert small[0, 0].tolist() == [200, 100, 50]
    assert small[1:].max() == 0


def test_depth_is_in_millimetres_and_empty_pixels_are_far() -> None:
    depth = np.full((FRAME_SIZE_PX, FRAME_SIZE_PX), 1.2344, np.float32)
    depth[:320] = 0
    depth[:, 320:] = 25.0
    small = shrink_depth(depth, 128)
    assert small.dtype == np.uint16
    assert small[100, 10] == 1234
    assert small[10, 10] == small[100, 100] == FAR_M * 1000


def test_each_mask_value_is_the_share_of_the_target_in_its_block() -> None:
    ids = np.zeros((FRAME_SIZE_PX, FRAME_SIZE_PX), np.uint16)
    ids[:40, :20] = 7
    mask = shrink_mask(ids, 7, 16)
    assert mask.shape == (16, 16)
    assert mask[0, 0] == 128
    assert mask.sum() == 128


def test_the_input_is_bounded_and_greater_for_nearer_surfaces() -> None:
    rgb = np.stack([np.zeros((64, 64, 3), np.uint8), np.full((64, 64, 3), 255, np.uint8)])
    depth = np.stack([np.full((64, 64), 1000, np.uint16), np.full((64, 64), 4000, np.uint16)])
    pictures = to_input(rgb, depth)
    assert pictures.shape == (2, 4, 64, 64)
    assert pictures.dtype == np.float32
    assert -1 <= pictures.min() <= pictures.max() <= 1
    assert pictures[0, 3, 0, 0] == pytest.approx(0.0, abs=1e-6)
    assert pictures[0, 3].min() > pictures[1, 3].max()


def batch(is_stop: bool) -> Batch:
    rng = np.random.default_rng(3)
    rgb = rng.integers(0, 256, (64, 64, 64, 3), dtype=np.uint8)
    depth = np.full((64, 64, 64), 1000, np.uint16)
    mask = np.zeros((64, 8, 8), np.float32)
    mask[:, :, 2] = 1
    actions, words = np.tile(np.float32((0.5, 0.3)), (64, 1)), np.tile(np.int64((2, 3, 0)), (64, 1))
    stops, known = np.full(64, is_stop), np.ones(64, bool)
    kinds = {"is_stop": stops, "has_stop": known, "has_twist": ~stops}
    goal = np.tile(np.float32((2.0, 0.4)), (64, 1))
    return Batch(to_input(rgb, depth), mask, actions, **kinds, goal=goal, words=words)


def test_mirrored_frames_have_the_opposite_yaw_rate_and_side_words() -> None:
    varied = augment(batch(is_stop=False), np.random.default_rng(0), SWAPPED)
    mirrored = varied.mask[:, 0, 5] == 1
    assert 10 < mirrored.sum() < 54
    assert (varied.actions[mirrored, 1] == np.float32(-0.3)).all()
    assert (varied.actions[~mirrored, 1] == np.float32(0.3)).all()
    assert (varied.actions[:, 0] == 0.5).all()
    assert (varied.goal[mirrored, 1] == np.float32(-0.4)).all()
    assert (varied.goal[~mirrored, 1] == np.float32(0.4)).all()
    assert (varied.goal[:, 0] == 2.0).all()
    assert (varied.words[mirrored] == (2, 4, 0)).all()
    assert (varied.words[~mirrored] == (2, 3, 0)).all()


def test_only_stop_frames_are_augmented_by_zoom() -> None:
    still = augment(batch(is_stop=True), np.random.default_rng(0), SWAPPED).pictures[:, 3]
    moving = augment(batch(is_stop=False), np.random.default_rng(0), SWAPPED).pictures[:, 3]
    nearest = to_input(np.zeros((1, 1, 1, 3), np.uint8), np.full((1, 1, 1), 750, np.uint16))[0, 3, 0, 0]
    assert np.allclose(moving, 0, atol=1e-6)
    assert 0.2 < (still.max(axis=(1, 2)) > 1e-3).mean() < 0.9
    assert still.max() <= nearest + 1e-6


def test_augmentation_keeps_its_input_and_is_reproducible() -> None:
    given = batch(is_stop=True)
    before = given.pictures.copy()
    first, second = (augment(given, np.random.default_rng(9), SWAPPED) for _ in range(2))
    assert np.array_equal(given.pictures, before)
    assert np.array_equal(first.pictures, second.pictures)
