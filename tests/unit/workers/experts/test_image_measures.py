"""Values that experts compute from a frame."""

from __future__ import annotations

import numpy as np

from schemas.config import TaskConfig
from workers.experts.observation import foreground_window, is_obstacle_near, measure_mask

DEPTH = np.full((640, 640), 3.0, np.float32)


def test_a_mask_gives_its_size_mean_column_and_median_depth():
    ids = np.zeros((640, 640), np.uint16)
    ids[100:110, 200:220] = 7
    depth = DEPTH.copy()
    depth[100:110, 200:219] = 2.0
    target_mask = measure_mask(ids, depth, 7, 32)
    assert (target_mask.pixels, target_mask.column, target_mask.measure_depth()) == (200, 210.0, 2.0)


def test_a_mask_that_fills_the_image_is_counted_whole():
    target_mask = measure_mask(np.full((640, 640), 7, np.uint16), DEPTH, 7, 32)
    assert (target_mask.pixels, target_mask.column, target_mask.measure_depth()) == (640 * 640, 320.0, 3.0)


def test_a_mask_below_the_threshold_gets_the_centre_column_and_no_depth():
    ids = np.zeros((640, 640), np.uint16)
    ids[0, :31] = 7
    target_mask = measure_mask(ids, DEPTH, 7, 32)
    assert (target_mask.pixels, target_mask.column, target_mask.measure_depth()) == (31, 320.0, 0.0)


def test_the_percentile_by_counting_agrees_with_numpy():
    rng = np.random.default_rng(0)
    task = TaskConfig()
    for low in (0.1, 0.2, 0.24, 0.26, 0.4):
        crop = rng.uniform(low, 3.0, (256, 320)).astype(np.float32)
        assert is_obstacle_near(crop, task) == (np.percentile(crop, 5) < 0.25)


def test_the_foreground_window_is_the_middle_of_the_image_below_the_horizon():
    assert foreground_window(TaskConfig()) == (352, 160, 608, 480)


def test_a_window_with_the_whole_mask_gives_the_measurements_of_the_image():
    rng = np.random.default_rng(0)
    ids, depth = np.zeros((640, 640), np.uint16), rng.uniform(0.5, 3.0, (640, 640)).astype(np.float32)
    ids[100:320, 211:499] = rng.integers(0, 3, (220, 288))
    whole = measure_mask(ids, depth, 2, 32)
    part = measure_mask(ids[90:330, 200:500], depth[90:330, 200:500], 2, 32, left=200)
    assert part[:2] == whole[:2]
    assert part.measure_depth() == whole.measure_depth()


def test_pixels_without_a_surface_do_not_count_as_near():
    assert not is_obstacle_near(np.zeros((256, 320), np.float32), TaskConfig())
