"""Images of a camera with its noise: colour and depth. Renders nothing; the caller passes the images."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from schemas.rig.cameras import Camera, PinholeCamera
from schemas.support.numpy_types import Floats, Singles
from workers.sensors.colour import noisy_colour
from workers.sensors.depth import noisy_depth
from workers.sensors.shutter import exposed, shutter_offsets
from workers.sensors.streams import NoiseKey


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
    return noisy_depth(depth, noise, camera.focal_px[0], key, step)
