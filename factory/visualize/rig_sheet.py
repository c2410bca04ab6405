"""Draws a contact sheet of a rig, with a row for each camera and each lidar: images, flow, normals, scans from above.

Writes no files.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont

from factory.dataset.bundle import EpisodeBundle
from factory.dataset.sensor_reading import observe, observe_camera
from factory.visualize.panels import show_depth, show_ids
from schemas.errors import UsageError
from schemas.rig import Camera, CameraOutput, Imu, Lidar2d, Lidar3d, Rig, WheelOdometry
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


_TILE_PX, _LABEL_PX, _FONT_PX = 240, 20, 13
_SHOWN = (CameraOutput.RGB, CameraOutput.DEPTH, CameraOutput.IDS)
_SHOWN_IF_GIVEN = (CameraOutput.NORMALS, CameraOutput.FLOW)


def draw_rig_sheet(episode: EpisodeBundle, rig: Rig, columns: int) -> Image.Image:
    """Returns a sheet with a row for each camera and lidar.

    The row of a camera shows colour from start to end, then depth, ids, normals and flow of the middle step. The row of
    a lidar shows scans from above, from start to end; for a 3D lidar, also the ranges of the middle step.

    Args:
        episode: bundle of the episode.
        rig: rig with at least one camera or lidar; its other sensors are not drawn.
        columns: number of colour images or scans in a row.

    Raises:
        UsageError: the rig has neither a camera nor a lidar.
    """
    shown = [sensor for sensor in rig.sensors if not isinstance(sensor, Imu | WheelOdometry)]
    if not shown:
        raise UsageError(f"rig {rig.name!r} has no camera and no lidar to show")
    rows = [
        _scans(episode, sensor, columns) if isinstance(sensor, Lidar2d | Lidar3d) else _row(episode, sensor, columns)
        for sensor in shown
    ]
    heights = [max(tile.height for tile in row) + _LABEL_PX for row in rows]
    sheet = Image.new("RGB", (max(map(len, rows)) * _TILE_PX, sum(heights)), "white")
    pen, font = ImageDraw.Draw(sheet), ImageFont.load_default(_FONT_PX)
    top = 0
    for sensor, row, height in zip(shown, rows, heights, strict=True):
        pen.text((4, top + _LABEL_PX / 2), _label(sensor), fill="black", font=font, anchor="lm")
        for column, tile in enumerate(row):
            sheet.paste(tile, (column * _TILE_PX, top + _LABEL_PX))
        top += height
    return sheet


def _row(episode: EpisodeBundle, camera: Camera, columns: int) -> list[Image.Image]:
    steps = _steps(episode, camera, columns)
    colour = camera.model_copy(update={"outputs": (CameraOutput.RGB,)})
    frames = [observe_camera(episode, colour, t).rgb for t in steps]
    shown = (*_SHOWN, *(output for output in _SHOWN_IF_GIVEN if output in camera.outputs))
    middle = observe_camera(episode, camera.model_copy(update={"outputs": shown}), steps[(columns - 1) // 2])
    assert middle.depth is not None
    assert middle.ids is not None
    pictures = [show_depth(middle.depth), show_ids(middle.ids, episode.meta.target_instance_id)]
    if middle.normals is not None:
        pictures.append(show_normals(middle.normals))
    if middle.flow is not None:
        pictures.append(show_flow(middle.flow))
    return [_tile(picture) for picture in (*frames, *pictures) if picture is not None]


def _scans(episode: EpisodeBundle, lidar: Lidar2d | Lidar3d, columns: int) -> list[Image.Image]:
    steps, target = _steps(episode, lidar, columns), episode.meta.target_instance_id
    scans = [observe(episode, lidar, t) for t in steps]
    tiles = [show_scan(scan, lidar, target, _TILE_PX) for scan in scans if isinstance(scan, LidarScan)]
    middle = scans[(columns - 1) // 2]
    if isinstance(lidar, Lidar3d) and isinstance(middle, LidarScan):
        ranges = Image.fromarray(show_depth(middle.ranges))
        tiles.append(ranges.resize((_TILE_PX, _TILE_PX // 2), Image.Resampling.NEAREST))
    return tiles


def _steps(episode: EpisodeBundle, sensor: Camera | Lidar2d | Lidar3d, columns: int) -> list[int]:
    """Returns the steps of measurements from start to end, evenly spaced."""
    stride = sensor.stride(episode.meta.job.task.control_hz)
    steps: list[int] = (np.linspace(0, (episode.length - 1) // stride, columns).round().astype(int) * stride).tolist()
    return steps


def _tile(picture: NDArray[np.uint8]) -> Image.Image:
    height = max(1, round(_TILE_PX * picture.shape[0] / picture.shape[1]))
    return Image.fromarray(picture).resize((_TILE_PX, height), Image.Resampling.BOX)


def _label(sensor: Camera | Lidar2d | Lidar3d) -> str:
    if isinstance(sensor, Lidar2d | Lidar3d):
        return f"{sensor.name}  {sensor.model}  {sensor.samples} rays a line; from above, 16 x 16 m, forward is up"
    return f"{sensor.name}  {sensor.model}  {sensor.width} x {sensor.height} px"
