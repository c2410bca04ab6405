"""Depth noise of triangulation: error by distance, occlusion, edges, holes and limits."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from schemas.rig.noise import StereoDepthNoise, StructuredLightNoise
from workers.sensors import NoiseKey
from workers.sensors.depth import edges, hidden, holes, noisy_depth, shifted

KEY = NoiseKey(1, 2, "front")
FOCAL_PX = 320.0
NOTHING_ELSE = {"edge_dropout": 0.0, "hole_share": 0.0, "range_max_m": 100.0}


def stereo(**fields: object) -> StereoDepthNoise:
    return StereoDepthNoise.model_validate({"model": "stereo", **NOTHING_ELSE, **fields})


def structured(**fields: object) -> StructuredLightNoise:
    return StructuredLightNoise.model_validate({"model": "structured_light", **NOTHING_ELSE, **fields})


def flat(distance: float, size: int = 400) -> NDArray[np.float32]:
    return np.full((size, size), distance, np.float32)


def object_before_a_wall() -> NDArray[np.float32]:
    """A wall at 4 m, and in front of it an object at 1 m in columns 150 to 249."""
    depth = flat(4.0)
    depth[100:300, 150:250] = 1.0
    return depth


@pytest.mark.parametrize("distance", [1.0, 3.0, 8.0])
def test_the_error_of_depth_grows_with_the_square_of_the_distance(distance: float) -> None:
    noise = stereo(disparity_std_px=0.05, disparity_step_px=0)
    seen = noisy_depth(flat(distance), noise, FOCAL_PX, KEY, 0)
    errors = seen[seen > 0] - distance
    expected = distance**2 * 0.05 / (FOCAL_PX * noise.baseline_m)
    assert errors.std() == pytest.approx(expected, rel=0.03)
    assert errors.mean() == pytest.approx(0, abs=0.05 * expected)


def test_disparities_are_multiples_of_the_resolution() -> None:
    noise = stereo(disparity_std_px=0.3, disparity_step_px=0.125)
    seen = noisy_depth(flat(3.3), noise, FOCAL_PX, KEY, 0)
    disparity = FOCAL_PX * noise.baseline_m / seen[seen > 0].astype(np.float64) / 0.125
    assert len(np.unique(np.rint(disparity))) > 5
    assert np.abs(disparity - np.rint(disparity)).max() < 1e-4


def test_structured_light_has_the_depth_steps_that_are_published_for_the_kinect() -> None:
    """With a focal length of 585 px, the steps at 4 m are 4.6 cm; Khoshelham and Elberink (2012) measure about 7 cm at
    5 m."""
    noise = structured(shift_std_px=0.0)
    seen = np.unique(noisy_depth(flat(4.0), noise, 585.0, KEY, 0))
    steps = np.diff(seen[seen > 0])
    assert len(steps)
    assert steps == pytest.approx(16 * 0.125 / (585 * 0.075), rel=0.05)


def test_noise_changes_no_measured_depth_when_all_parameters_are_zero() -> None:
    noise = stereo(disparity_std_px=0.0, disparity_step_px=0.0)
    depth = object_before_a_wall()
    seen = noisy_depth(depth, noise, FOCAL_PX, KEY, 0)
    assert seen[seen > 0] == pytest.approx(depth[seen > 0], rel=1e-6)


# Occlusion --------------------------------------------------------------------------------------------------------


def test_a_second_camera_on_the_right_does_not_see_a_strip_left_of_an_object() -> None:
    baseline = 0.15
    depth = object_before_a_wall()
    unseen = hidden(np.float32(FOCAL_PX * baseline) / depth, "right")
    jump = round(FOCAL_PX * baseline * (1 / 1.0 - 1 / 4.0))
    strip = unseen[200]
    assert strip[150 - jump : 150].all()
    assert not strip[150:].any()
    border = round(FOCAL_PX * baseline / 4.0)  # these columns are outside of the second image
    assert np.flatnonzero(strip[: 150 - jump]).tolist() == list(range(border))
    assert np.flatnonzero(unseen[50]).tolist() == list(range(border))


def test_a_second_camera_on_the_left_gives_the_mirrored_image() -> None:
    disparity = np.float32(48) / object_before_a_wall()[:, ::-1][:, 3:]
    assert (hidden(disparity, "left") == hidden(disparity[:, ::-1], "right")[:, ::-1]).all()


def test_occlusion_equals_the_result_of_projecting_every_pixel_into_the_second_image() -> None:
    rng = np.random.default_rng(3)
    disparity = np.repeat(rng.uniform(1, 30, (20, 12)), 8, axis=1).astype(np.float32)
    columns = np.arange(disparity.shape[1])
    for row, unseen in zip(disparity, hidden(disparity, "right"), strict=True):
        other = columns - row
        covered = [(other[x + 1 :] <= other[x]).any() or other[x] < 0 for x in columns]
        assert unseen.tolist() == covered


# Edges and holes --------------------------------------------------------------------------------------------------


def test_dropouts_are_at_edges_only() -> None:
    depth = object_before_a_wall()
    noise = stereo(edge_dropout=1.0)
    without = noisy_depth(depth, stereo(), FOCAL_PX, KEY, 0) > 0
    lost = without & (noisy_depth(depth, noise, FOCAL_PX, KEY, 0) == 0)
    half = noise.window_px // 2
    rows, columns = np.nonzero(lost)
    beside = np.minimum(np.abs(columns - 149.5), np.abs(columns - 249.5)) < half + 1
    above = np.minimum(np.abs(rows - 99.5), np.abs(rows - 299.5)) < half + 1
    assert lost.any()
    assert (beside | above).all()


def test_a_slanted_plane_has_no_edges() -> None:
    rows, columns = np.mgrid[:300, :300]
    disparity = (0.45 * rows + 0.2 * columns).astype(np.float32)  # a floor seen from 0.33 m above it, turned
    assert not edges(disparity, 9).any()


def test_the_share_of_lost_pixels_at_edges_is_the_parameter() -> None:
    depth = object_before_a_wall()
    exact = np.float32(FOCAL_PX * 0.15) / depth
    candidates = edges(exact, 9) & ~hidden(exact, "right")
    seen = noisy_depth(depth, stereo(edge_dropout=0.3), FOCAL_PX, KEY, 0)
    assert (seen[candidates] == 0).mean() == pytest.approx(0.3, abs=0.03)


@pytest.mark.parametrize("share", [0.0, 0.02, 0.3, 1.0])
def test_holes_cover_the_given_share_in_spots_of_several_pixels(share: float) -> None:
    found = np.array([holes((640, 640), share, KEY, step) for step in range(4)])
    assert found.mean() == pytest.approx(share, abs=0.15 * share + 1e-9)
    if 0 < share < 0.1:
        borders = (found[:, :, 1:] != found[:, :, :-1]).mean()
        assert borders < found.mean() / 3  # 2 * share if each hole was a single pixel


def test_holes_differ_between_steps() -> None:
    assert (holes((640, 640), 0.1, KEY, 0) != holes((640, 640), 0.1, KEY, 1)).any()


# Limits -----------------------------------------------------------------------------------------------------------


def test_depth_outside_of_the_range_and_without_a_surface_is_not_measured() -> None:
    depth = np.concatenate([flat(each, 64) for each in (0.0, 0.29, 5.0, 10.1)])
    seen = noisy_depth(depth, stereo(range_min_m=0.3, range_max_m=10.0), FOCAL_PX, KEY, 0)
    parts = seen.reshape(4, 64, 64)
    assert not parts[[0, 1, 3]].any()
    assert (parts[2] > 0).mean() > 0.8
    assert np.isfinite(seen).all()


def test_a_large_error_of_disparity_gives_no_negative_depth() -> None:
    seen = noisy_depth(flat(50.0), stereo(disparity_std_px=2.0), FOCAL_PX, KEY, 0)
    assert (seen >= 0).all()
    assert np.isfinite(seen).all()


def test_displaced_pixels_take_their_depth_from_a_neighbour() -> None:
    depth = object_before_a_wall()
    moved = shifted(depth, 0.5, KEY, 0)
    assert set(np.unique(moved)) == {1.0, 4.0}
    rows, columns = np.nonzero(moved != depth)
    assert len(rows)
    near = np.minimum(np.abs(columns - 149.5), np.abs(columns - 249.5)) < 2.1
    near |= np.minimum(np.abs(rows - 99.5), np.abs(rows - 299.5)) < 2.1
    assert near.all()


def test_displacements_have_the_given_standard_deviation() -> None:
    ramp = np.tile(np.arange(400, dtype=np.float32), (400, 1))
    offsets = (shifted(ramp, 1.5, KEY, 0) - ramp)[20:-20, 20:-20]
    assert offsets.std() == pytest.approx(np.sqrt(1.5**2 + 1 / 12), rel=0.05)  # rounded to whole pixels
    assert offsets.mean() == pytest.approx(0, abs=0.02)


def test_the_same_key_and_step_give_the_same_image_and_other_steps_do_not() -> None:
    depth, noise = object_before_a_wall(), StereoDepthNoise(model="stereo")
    first = noisy_depth(depth, noise, FOCAL_PX, KEY, 4)
    noisy_depth(depth, noise, FOCAL_PX, KEY, 9)
    assert (noisy_depth(depth, noise, FOCAL_PX, KEY, 4) == first).all()
    assert (noisy_depth(depth, noise, FOCAL_PX, KEY, 5) != first).mean() > 0.3
