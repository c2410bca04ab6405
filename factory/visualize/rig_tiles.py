"""Draws measurements of a rig as pictures: optical flow, normals, and scans from above. Writes no files."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw

from factory.visualize.panels import show_ids
from schemas.rig import Lidar2d, Lidar3d
from workers.geometry.camera import mount_rotation
from workers.sensors import LidarScan, points_of

Rgb = NDArray[np.uint8]
_SCAN_SHOWN_M = 8.0
"""Distance from the robot to the edge of the picture of a scan, metres."""
_STRONGEST = 0.95
"""Flow vectors that are longer than this quantile of the lengths have full saturation."""


def show_normals(normals: NDArray[np.float32]) -> Rgb:
    """Returns unit normals (H, W, 3) as colours: a component of 0 is 127; pixels without a surface are grey."""
    return ((normals + 1) * 127.5).astype(np.uint8)


def show_flow(flow: NDArray[np.float32]) -> Rgb:
    """Returns optical flow (H, W, 2) as colours (H, W, 3) of the HSV wheel.

    The hue is the direction (red is to the right). The saturation is the length relative to its 95 % quantile in the
    image, at most 1. Undefined pixels are black.
    """
    length, is_defined = np.hypot(flow[..., 0], flow[..., 1]), np.isfinite(flow[..., 0])
    longest = max(float(np.quantile(length[is_defined], _STRONGEST)) if is_defined.any() else 0.0, 1e-6)
    turn = np.nan_to_num(np.arctan2(flow[..., 1], flow[..., 0]) / (2 * np.pi) % 1)
    strength = np.clip(np.nan_to_num(length) / longest, 0, 1)
    wheel = np.stack((turn, strength, is_defined), axis=-1)
    return np.asarray(Image.fromarray((wheel * 255).astype(np.uint8), "HSV").convert("RGB"))


def show_scan(scan: LidarScan, lidar: Lidar2d | Lidar3d, target: int, size: int) -> Image.Image:
    """Draws a top view of the points that a lidar measured, in the colours of their instances; the robot faces up.

    Args:
        scan: scan of the lidar.
        lidar: model with its mounting pose.
        target: instance id that is drawn in red.
        size: side of the square picture, pixels; its edges are `_SCAN_SHOWN_M` from base_link.
    """
    ahead = points_of(scan, lidar) @ mount_rotation(lidar.mount).T[:, :2] + (lidar.mount.x_m, lidar.mount.y_m)
    middle, scale = size / 2, size / 2 / _SCAN_SHOWN_M
    columns, rows = (
        np.floor(middle - ahead[:, 1] * scale).astype(int),
        np.floor(middle - ahead[:, 0] * scale).astype(int),
    )
    inside = (columns >= 0) & (columns < size) & (rows >= 0) & (rows < size)
    pixels = np.full((size, size, 3), 255, np.uint8)
    pixels[rows[inside], columns[inside]] = show_ids(scan.ids[scan.ranges > 0], target)[inside]
    picture = Image.fromarray(pixels)
    nose, tail = middle - 0.3 * scale, middle + 0.3 * scale
    ImageDraw.Draw(picture).polygon([(middle, nose), (nose, tail), (tail, tail)], outline=(20, 80, 220))
    return picture
