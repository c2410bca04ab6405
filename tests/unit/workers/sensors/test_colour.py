"""Colour noise: photon statistics, exposure, white balance, JPEG; motion blur and rolling shutter."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from schemas.rig.cameras import PinholeCamera
from schemas.rig.noise import CameraNoise, ColourNoise
from workers.sensors import NoiseKey, colour_steps, sense_colour
from workers.sensors.images import (
    channel_gains,
    codes_of,
    exposed,
    linear_of_codes,
    noisy_colour,
    row_weights,
    shutter_offsets,
)

Image = NDArray[np.uint8]
KEY = NoiseKey(1, 2, "front")
QUIET = ColourNoise(has_electrons=False)
HZ = 60


def flat(code: int, size: int = 200) -> Image:
    return np.full((size, size, 3), code, np.uint8)


def every_code() -> Image:
    return np.repeat(np.arange(256, dtype=np.uint8)[:, None], 3, axis=1)[None]


@pytest.mark.parametrize("code", [60, 128, 200])
def test_the_variance_is_that_of_the_electrons_plus_that_of_the_read_noise(code: int) -> None:
    noise = ColourNoise(full_well_e=4000, read_noise_e=8, gain_db=6)
    light = linear_of_codes()[noisy_colour(flat(code, 400), noise, KEY, 0)]
    white = 4000 / 10 ** (6 / 20)
    electrons = linear_of_codes()[code] * white
    rounding = (linear_of_codes()[code + 1] - linear_of_codes()[code]) ** 2 / 12
    assert light.var() == pytest.approx((electrons + 64) / white**2 + rounding, rel=0.03)
    assert light.mean() == pytest.approx(electrons / white, rel=2e-3)


def test_noise_is_independent_between_channels_pixels_and_steps() -> None:
    first, second = (noisy_colour(flat(128), ColourNoise(), KEY, step).astype(float) - 128 for step in (0, 1))
    planes = [*first.transpose(2, 0, 1), second[..., 0], np.roll(first[..., 0], 1)]
    assert np.abs(np.corrcoef([plane.ravel() for plane in planes]) - np.eye(5)).max() < 0.03


def test_an_image_without_noise_and_with_gain_1_stays_as_it_is() -> None:
    assert (noisy_colour(every_code(), QUIET, KEY, 0) == every_code()).all()


def test_one_stop_of_exposure_doubles_the_light() -> None:
    brighter = noisy_colour(every_code(), ColourNoise(has_electrons=False, exposure_stops=1), KEY, 0)[0, :, 0]
    light = linear_of_codes()
    assert (brighter == codes_of(np.minimum(2 * light, 1))).all()
    assert brighter.max() == 255


def test_exposure_and_white_balance_are_constant_in_an_episode_and_vary_between_episodes() -> None:
    noise = ColourNoise(exposure_std_stops=0.3, white_balance_std_stops=0.1, has_electrons=False)
    first, later = (noisy_colour(flat(100), noise, KEY, step) for step in (0, 77))
    assert (first == later).all()
    gains = np.log2([channel_gains(noise, NoiseKey(1, episode, "front")) for episode in range(500)])
    assert gains[:, 1].std() == pytest.approx(0.3, rel=0.1)
    assert (gains[:, 0] - gains[:, 1]).std() == pytest.approx(0.1, rel=0.1)
    assert (gains[:, 2] - gains[:, 1]).std() == pytest.approx(0.1, rel=0.1)


def test_white_balance_multiplies_each_channel() -> None:
    noise = ColourNoise(white_balance=(1.5, 1.0, 0.5), has_electrons=False)
    red, green, blue = noisy_colour(flat(100, 8), noise, KEY, 0)[0, 0]
    light = linear_of_codes()[100]
    assert (red, green, blue) == (codes_of(np.array(1.5 * light)), 100, codes_of(np.array(0.5 * light)))


def test_jpeg_loses_more_with_a_lower_quality() -> None:
    rows, columns = np.mgrid[:128, :128]
    image = np.stack((rows * 2, columns * 2, (rows + columns) % 64 * 4), axis=-1).astype(np.uint8)
    errors = []
    for quality in (95, 60, 20):
        noise = ColourNoise(has_electrons=False, jpeg_quality=quality)
        errors.append(np.abs(noisy_colour(image, noise, KEY, 0).astype(int) - image).mean())
    assert 0 < errors[0] < errors[1] < errors[2] < 40


def test_srgb_has_the_values_of_its_standard() -> None:
    light = linear_of_codes()
    assert (light[0], light[255]) == (0, 1)
    assert light[188] == pytest.approx(0.5028864580325687)  # colour-science, eotf_inverse of IEC 61966-2-1
    assert (codes_of(light) == np.arange(256)).all()


# Shutter ----------------------------------------------------------------------------------------------------------


def test_an_image_without_motion_effects_needs_one_render_at_its_step() -> None:
    assert shutter_offsets(ColourNoise(), HZ).tolist() == [0]


def test_renders_are_spread_over_the_exposure_before_the_step() -> None:
    noise = ColourNoise(motion_blur_s=0.02, rolling_shutter_s=0.01, shutter_images=6)
    offsets = shutter_offsets(noise, HZ)
    assert np.diff(offsets) == pytest.approx(0.03 * HZ / 6)
    assert offsets[-1] == pytest.approx(-0.03 * HZ / 12)
    assert (offsets < 0).all()


@pytest.mark.parametrize("noise", [
    ColourNoise(motion_blur_s=0.02), ColourNoise(rolling_shutter_s=0.02),
    ColourNoise(motion_blur_s=0.01, rolling_shutter_s=0.015, shutter_images=13)])  # fmt: skip
def test_weights_of_a_row_add_up_to_1_and_lower_rows_are_exposed_later(noise: ColourNoise) -> None:
    weights = row_weights(noise, 480)
    assert weights.sum(axis=0) == pytest.approx(1)
    centres = weights.T @ np.arange(noise.shutter_images)
    assert (np.diff(centres) >= -1e-5).all()
    share = noise.rolling_shutter_s / (noise.rolling_shutter_s + noise.motion_blur_s)
    assert centres[-1] - centres[0] == pytest.approx(share * noise.shutter_images, abs=1)


def moving_bar(count: int, shift: int, size: int = 96) -> Image:
    """A vertical bar that moves right by `shift` pixels between renders."""
    images = np.zeros((count, size, size, 3), np.uint8)
    for k, image in enumerate(images):
        image[:, 20 + k * shift : 24 + k * shift] = 255
    return images


def test_motion_blur_is_the_mean_of_the_light() -> None:
    noise = ColourNoise(motion_blur_s=0.02, shutter_images=4)
    blurred = exposed(moving_bar(4, 4), noise)
    assert (blurred[:, 20:36] == codes_of(np.array(0.25))).all()
    assert not blurred[:, 36:].any()


def test_a_rolling_shutter_shears_a_bar_that_moves() -> None:
    noise = ColourNoise(rolling_shutter_s=0.02, shutter_images=8)
    image = exposed(moving_bar(8, 4), noise)
    lefts = (image[..., 0] > 0).argmax(axis=1)
    assert (lefts[0], lefts[-1]) == (20, 48)
    assert (np.diff(lefts) >= 0).all()


def test_a_scene_at_rest_is_not_changed_by_the_shutter() -> None:
    noise = ColourNoise(motion_blur_s=0.01, rolling_shutter_s=0.01)
    still = np.random.default_rng(1).integers(0, 256, (64, 64, 3), dtype=np.uint8)
    assert (exposed(np.stack([still] * noise.shutter_images), noise) == still).all()


def test_a_camera_without_noise_needs_one_render_and_returns_it() -> None:
    camera = PinholeCamera(name="front", model="pinhole", width=64, height=64, fov_deg=90)
    image = flat(77, 64)
    assert colour_steps(camera, 12, HZ).tolist() == [12]
    assert (sense_colour(camera, image[None], KEY, 12) == image).all()


def test_a_camera_with_noise_asks_for_renders_before_its_step() -> None:
    noise = CameraNoise(colour=ColourNoise(motion_blur_s=0.01))
    camera = PinholeCamera(name="front", model="pinhole", width=64, height=64, fov_deg=90, noise=noise)
    steps = colour_steps(camera, 12, HZ)
    assert 12 - 0.01 * HZ < steps.min() < steps.max() < 12
    image = sense_colour(camera, np.stack([flat(77, 64)] * len(steps)), KEY, 12)
    assert image.mean() == pytest.approx(77, abs=1)
    assert 1 < image.std() < 5
