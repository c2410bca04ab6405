"""Lidar with one or several scan lines: rays against the drawn triangles of a scene, and the noise of their ranges.

Opens no scene; the caller passes a `workers.sensors.rays.SceneRays`. The robot is not drawn, so no ray hits it.
"""

from __future__ import annotations

import functools
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from schemas.rig.noise import LidarNoise
from schemas.rig.sensors import Lidar2d, Lidar3d
from schemas.support.numpy_types import Floats, Singles
from schemas.support.portable import cos, sin
from workers.sensors.frames import poses_at, sensor_poses, turned
from workers.sensors.streams import Effect, NoiseKey


@dataclass(frozen=True)
class RayHits:
    """Hits of N rays; all values are 0 without a hit."""

    distances: Singles
    """(N,) distance of the surface, metres."""
    ids: NDArray[np.uint16]
    """(N,) instance id of the surface."""
    cosines: Singles
    """(N,) cosine of the angle of incidence, 0 to 1."""


class RayCaster(Protocol):
    """Ray caster of a scene."""

    def nearest(self, origins: Floats, directions: Floats, reach_m: float) -> RayHits:
        """Returns the first hit of each of N rays.

        Args:
            origins: (N, 3) positions in the world, metres.
            directions: (N, 3) unit vectors in the world.
            reach_m: maximum distance, metres.
        """


@dataclass(frozen=True)
class LidarScan:
    """One revolution; rows are scan lines from top to bottom, columns are azimuths in the order of measurement."""

    ranges: Singles
    """(lines, samples) distance from the origin of the sensor frame, metres; 0 without a return."""
    ids: NDArray[np.uint16]
    """(lines, samples) instance id of the surface; 0 without a return."""
    cosines: Singles
    """(lines, samples) cosine of the angle of incidence on the surface, 0 to 1."""


def sense_lidar(
    rays: RayCaster, lidar: Lidar2d | Lidar3d, poses: Floats, step: int, control_hz: int, key: NoiseKey
) -> LidarScan:
    """Returns the scan that ends at a control step.

    Args:
        rays: ray caster of the scene.
        lidar: model of the lidar with its mounting pose.
        poses: (T, 7) recorded poses of base_link in the world.
        step: control step, 0 to T - 1.
        control_hz: control rate, steps per second.
        key: identity of the sensor in the episode, which determines the noise.
    """
    noise = lidar.noise
    lag: Floats = np.zeros(1)
    if noise is not None and noise.sweep_s:
        lag = np.arange(1.0 - lidar.samples, 1) * (noise.sweep_s * control_hz / lidar.samples)
    origins, rotations = sensor_poses(poses_at(poses, step + lag), lidar.mount)
    directions = ray_directions(lidar)
    shape = directions.shape
    ways = turned(rotations, directions).reshape(-1, 3)
    hits = rays.nearest(np.broadcast_to(origins, shape).reshape(-1, 3), ways, lidar.range_max_m)
    lines = shape[:2]
    scan = LidarScan(hits.distances.reshape(lines), hits.ids.reshape(lines), hits.cosines.reshape(lines))
    ranges = scan.ranges if noise is None else noisy_ranges(scan, noise, key, step)
    kept = (ranges >= lidar.range_min_m) & (ranges <= lidar.range_max_m)
    return LidarScan(ranges * kept, scan.ids * kept, scan.cosines * kept)


def noisy_ranges(scan: LidarScan, noise: LidarNoise, key: NoiseKey, step: int) -> Singles:
    """Returns noisy, quantised ranges (lines, samples), metres; 0 where a return is lost.

    A return is lost at random, or because it is too weak: the received power of a matt surface that fills the beam is
    proportional to cos(a) / r^2 (W. Wagner et al., "Gaussian decomposition and calibration of a novel small-footprint
    full-waveform digitising airborne laser scanner", ISPRS Journal 60(2), 2006), so the longest range is
    `matt_range_m` times the square root of cos(a).

    Args:
        scan: scan without noise.
        noise: parameters.
        key: identity of the sensor in the episode.
        step: control step of the scan.
    """
    ranges, kept = scan.ranges, scan.ranges > 0
    if noise.matt_range_m is not None:
        kept &= ranges * ranges <= np.float32(noise.matt_range_m**2) * scan.cosines
    if noise.dropout:
        kept &= ~key.is_below(noise.dropout, Effect.RAY_DROPOUT, ranges.shape, step)
    spread = np.sqrt(np.float32(noise.range_std_m**2) + (ranges * np.float32(noise.range_std_share)) ** 2)
    ranges = np.maximum(ranges + spread * key.normals(Effect.RANGE, ranges.shape, step), np.float32(0))
    if noise.range_step_m:
        ranges = np.rint(ranges / np.float32(noise.range_step_m)) * np.float32(noise.range_step_m)
    return np.asarray(ranges * kept)


@functools.lru_cache(maxsize=32)
def ray_directions(lidar: Lidar2d | Lidar3d) -> Floats:
    """Returns unit vectors (lines, samples, 3) of the rays in the sensor frame (x forward, y left, z up)."""
    elevations = np.radians(lidar.elevations_deg if isinstance(lidar, Lidar3d) else (0.0,))
    azimuths = ray_azimuths(lidar)
    flat, up = cos(elevations)[:, None], sin(elevations)[:, None]
    x, y = flat * cos(azimuths), flat * sin(azimuths)
    return np.moveaxis(np.stack((x, y, np.broadcast_to(up, x.shape))), 0, 2)


def ray_azimuths(lidar: Lidar2d | Lidar3d) -> Floats:
    """Returns the azimuths (samples,) of the rays of each line, radians, in the order of measurement."""
    span = lidar.azimuth_max_deg - lidar.azimuth_min_deg
    return np.asarray(np.radians(lidar.azimuth_min_deg + np.arange(lidar.samples) * (span / lidar.samples)))


def points_of(scan: LidarScan, lidar: Lidar2d | Lidar3d) -> Singles:
    """Returns the points (returns, 3) of a scan in the sensor frame, metres, line by line."""
    has_return = scan.ranges > 0
    return (ray_directions(lidar)[has_return] * scan.ranges[has_return][:, None]).astype(np.float32)
