"""Projection of the camera models of rigs: from points in the optical frame to pixels, and from pixels to rays.

The optical frame has x right, y down and z forward. Pixels are (column, row); the image spans [0, width) and
[0, height), see `schemas.rig.cameras`. Pure functions in float64. Does not render.
"""

from __future__ import annotations

import functools
import math

import numpy as np

from schemas.rig import Camera, EquirectangularCamera, FisheyeCamera, PinholeCamera
from schemas.rig.distortion import distort, fisheye_angles, fisheye_radii, undistort
from schemas.support import portable
from schemas.support.numpy_types import Floats
from workers.geometry.camera import OpticalPose


def project(camera: Camera, points: Floats) -> Floats:
    """Returns the pixels (..., 2) of points (..., 3) in the optical frame, metres.

    NaN where the camera does not see in that direction: behind a pinhole camera, outside of the image circle of a
    fisheye camera. Other pixels may be outside of the image.
    """
    with np.errstate(divide="ignore", invalid="ignore"):
        if isinstance(camera, PinholeCamera):
            return _project_pinhole(camera, points)
        if isinstance(camera, FisheyeCamera):
            return _project_fisheye(camera, points)
        return _project_equirectangular(camera, points)


def unproject(camera: Camera, pixels: Floats) -> Floats:
    """Returns the unit vectors (..., 3) in the optical frame of pixels (..., 2); NaN where the camera sees nothing."""
    if isinstance(camera, EquirectangularCamera):
        return _unproject_equirectangular(camera, pixels)
    plane = (pixels - camera.centre_px) / camera.focal_px
    if isinstance(camera, PinholeCamera):
        plane = undistort(plane, camera.distortion) if camera.is_distorted else plane
        rays = np.concatenate((plane, np.ones((*plane.shape[:-1], 1))), axis=-1)
        return np.asarray(rays / np.linalg.norm(rays, axis=-1, keepdims=True))
    radii = np.linalg.norm(plane, axis=-1)
    angles = fisheye_angles(radii, camera.half_fov_rad, camera.distortion)
    share = portable.sin(angles) / np.where(radii > 0, radii, 1.0)
    return np.stack((plane[..., 0] * share, plane[..., 1] * share, portable.cos(angles)), axis=-1)


def pixel_centres(camera: Camera) -> Floats:
    """Returns the centres (height, width, 2) of all pixels."""
    columns, rows = np.arange(camera.width) + 0.5, np.arange(camera.height) + 0.5
    return np.stack(np.meshgrid(columns, rows), axis=-1)


@functools.lru_cache(maxsize=4)
def _pixel_rays(camera: Camera) -> Floats:
    rays = unproject(camera, pixel_centres(camera))
    rays.flags.writeable = False
    return rays


def axial_share(camera: Camera) -> Floats:
    """Returns the axial depth (height, width) of points at a distance of 1 m from the optical centre."""
    return np.asarray(_pixel_rays(camera.lens())[..., 2])


def optical_flow(camera: Camera, distance_m: Floats, now: OpticalPose, later: OpticalPose) -> Floats:
    """Returns the flow (height, width, 2) of a static scene, pixels to the right and down.

    Args:
        camera: camera model.
        distance_m: (height, width) distances from the optical centre at the first instant, metres; 0 for no surface.
        now: pose of the optical frame at the first instant.
        later: pose of the optical frame at the second instant.

    Returns:
        Displacement of the point seen in each pixel; NaN where no surface was hit or the camera does not see the point
        at the second instant. Points that are hidden at the second instant have a flow too.
    """
    pixels = pixel_centres(camera)
    points = _pixel_rays(camera.lens()) * np.where(distance_m > 0, distance_m, np.nan)[..., None]
    moved = (points @ now.rotation.T + (now.eye - later.eye)) @ later.rotation
    flow = project(camera, moved) - pixels
    if isinstance(camera, EquirectangularCamera):  # the shorter of the two directions around the panorama
        flow[..., 0] -= np.rint(flow[..., 0] / camera.width) * camera.width
    return flow


def _project_pinhole(camera: PinholeCamera, points: Floats) -> Floats:
    depth = np.where(points[..., 2:] > 0, points[..., 2:], np.nan)
    plane = points[..., :2] / depth
    return distort(plane, camera.distortion) * camera.focal_px + camera.centre_px


def _project_fisheye(camera: FisheyeCamera, points: Floats) -> Floats:
    aside = np.hypot(points[..., 0], points[..., 1])
    angles = np.arctan2(aside, points[..., 2])
    radii = np.where(angles <= camera.half_fov_rad, fisheye_radii(angles, camera.distortion), np.nan)
    share = np.where(aside > 0, radii / aside, 0.0)
    share = np.where(np.isnan(radii), np.nan, share)
    return points[..., :2] * share[..., None] * camera.focal_px + camera.centre_px


def _project_equirectangular(camera: EquirectangularCamera, points: Floats) -> Floats:
    azimuth = np.arctan2(points[..., 0], points[..., 2])  # positive to the right
    elevation = np.arctan2(-points[..., 1], np.hypot(points[..., 0], points[..., 2]))
    top, bottom = math.radians(camera.top_deg), math.radians(camera.bottom_deg)
    rows = np.where((elevation <= top) & (elevation >= bottom), (top - elevation) / (top - bottom), np.nan)
    return np.stack(((azimuth / (2 * math.pi) + 0.5) * camera.width, rows * camera.height), axis=-1)


def _unproject_equirectangular(camera: EquirectangularCamera, pixels: Floats) -> Floats:
    azimuth = (pixels[..., 0] / camera.width - 0.5) * (2 * math.pi)
    top, bottom = math.radians(camera.top_deg), math.radians(camera.bottom_deg)
    elevation = top - pixels[..., 1] / camera.height * (top - bottom)
    level = portable.cos(elevation)
    return np.stack((portable.sin(azimuth) * level, -portable.sin(elevation), portable.cos(azimuth) * level), axis=-1)
