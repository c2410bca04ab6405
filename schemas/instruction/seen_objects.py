"""Measures distance and direction of the objects in an image. Pure functions; renders nothing."""

from __future__ import annotations

import math
from collections.abc import Collection
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from schemas.config import CameraConfig
from schemas.instruction.referents import ids_in_view


@dataclass(frozen=True)
class SeenObject:
    """Object in view of the camera."""

    id: int
    """Value of its pixels in the id image."""
    range_m: float
    """Distance from the camera to the nearest visible point, metres."""
    bearing_rad: float
    """Horizontal angle from the optical axis to the mean column of the mask, radians; positive to the right."""
    pixels: int
    """Size of its mask, pixels."""


def see_objects(
    ids: NDArray[np.uint16],
    depth: NDArray[np.float32],
    objects: Collection[int],
    camera: CameraConfig,
    min_pixels: int,
) -> tuple[SeenObject, ...]:
    """Returns the given objects that are in view, in the order of their ids.

    Args:
        ids: (S, S) instance ids.
        depth: (S, S) metres along the optical axis, 0 where the ray hits nothing.
        objects: ids of the objects to find.
        camera: camera of the image.
        min_pixels: smallest mask of an object in view, pixels.
    """
    found = sorted(ids_in_view(ids, min_pixels).intersection(objects))
    # tangents of the angles from the optical axis to the centres of the pixels of a row or column
    half = ids.shape[0] / 2
    tangents = (np.arange(ids.shape[0]) + 0.5 - half) / half * math.tan(math.radians(camera.fov_deg) / 2)
    return tuple(_see(number, np.nonzero(ids == number), depth, tangents) for number in found)


def _see(
    number: int,
    pixels: tuple[NDArray[np.intp], ...],
    depth: NDArray[np.float32],
    tangents: NDArray[np.float64],
) -> SeenObject:
    """Returns the object with this id from the rows and columns of its pixels."""
    up, aside = tangents[pixels[0]], tangents[pixels[1]]
    ranges = depth[pixels] * np.sqrt(1 + up**2 + aside**2)
    return SeenObject(number, float(ranges.min()), math.atan(float(aside.mean())), len(ranges))
