"""One picture of an episode for people: frames in colour, depth and ids over time, and the track from above. Pure."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw

from schemas.bundle import BundleReader
from schemas.scene import CompiledScene

__all__ = ["draw_contact_sheet"]

_TILE_PX = 240
_HEAD_PX = 46
_DEPTH_SHOWN_M = 10.0
_TRACK_PX_PER_M = 30
Rgb = NDArray[np.uint8]


def draw_contact_sheet(episode: BundleReader, scene: CompiledScene, columns: int = 6) -> Image.Image:
    """Returns a sheet: three rows of frames from start to stop, the track above the map, and the instruction.

    Args:
        episode: the bundle.
        scene: the package it was made in, for the map.
        columns: frames across.
    """
    steps = np.linspace(0, episode.length - 1, columns).round().astype(int)
    rows = [
        [episode.rgb(t) for t in steps],
        [_show_depth(episode.depth(t)) for t in steps],
        [_show_ids(episode.ids(t), episode.meta.target_instance_id) for t in steps],
    ]
    track = _draw_track(episode, scene)
    width = columns * _TILE_PX + track.width
    sheet = Image.new("RGB", (width, _HEAD_PX + 3 * _TILE_PX), "white")
    for row, tiles in enumerate(rows):
        for column, tile in enumerate(tiles):
            small = Image.fromarray(tile).resize((_TILE_PX, _TILE_PX), Image.Resampling.BILINEAR)
            sheet.paste(small, (column * _TILE_PX, _HEAD_PX + row * _TILE_PX))
    sheet.paste(track, (columns * _TILE_PX, _HEAD_PX))
    _write_head(sheet, episode)
    return sheet


def _write_head(sheet: Image.Image, episode: BundleReader) -> None:
    job, rollout = episode.meta.job, episode.meta.rollout
    draw = ImageDraw.Draw(sheet)
    draw.text((8, 4), f"{job.episode_id}  {job.scene}  {job.split}  {job.tier}  {job.instruction}", fill="black")
    facts = (
        f"{job.target_id} ({job.colour})  attempt {job.attempt}  {rollout.num_steps} steps  "
        f"start {rollout.spawn_dist_m:.2f} m  TL {rollout.trajectory_length_m:.2f} m  NE {rollout.final_ne_m:.3f} m"
    )
    draw.text((8, 24), facts, fill="black")


def _show_depth(depth: NDArray[np.float32]) -> Rgb:
    grey = (255 * (1 - np.clip(depth / _DEPTH_SHOWN_M, 0, 1))).astype(np.uint8)
    grey[depth == 0] = 0
    return np.repeat(grey[:, :, None], 3, axis=2)


def _show_ids(ids: NDArray[np.uint16], target: int) -> Rgb:
    mixed = ids.astype(np.uint32) * np.uint32(2654435761)
    colours = np.stack([mixed >> 24, mixed >> 16, mixed >> 8], axis=-1).astype(np.uint8) // 2 + 40
    colours[ids == 0] = 0
    colours[ids == target] = (255, 40, 40)
    return colours


def _draw_track(episode: BundleReader, scene: CompiledScene) -> Image.Image:
    size = 3 * _TILE_PX
    track = episode.arrays.poses[:, :2].astype(float)
    goal = np.array(episode.meta.target_centroid_m[:2])
    points = np.vstack([track, goal])
    centre = (points.min(axis=0) + points.max(axis=0)) / 2
    span_m = max(float(np.ptp(points, axis=0).max()) + 3.0, size / _TRACK_PX_PER_M / 3)
    scale = size / span_m

    def pixel(xy: NDArray[np.float64]) -> tuple[float, float]:
        return size / 2 + (xy[0] - centre[0]) * scale, size / 2 - (xy[1] - centre[1]) * scale

    picture = _map_window(scene, centre, span_m, size)
    draw = ImageDraw.Draw(picture)
    draw.line([pixel(point) for point in track], fill=(20, 80, 220), width=3)
    gx, gy = pixel(goal)
    radius = episode.meta.job.task.success_radius_m * scale
    draw.ellipse((gx - radius, gy - radius, gx + radius, gy + radius), outline=(220, 30, 30), width=2)
    draw.ellipse((gx - 5, gy - 5, gx + 5, gy + 5), fill=(220, 30, 30))
    for point, colour in ((track[0], (20, 160, 60)), (track[-1], (20, 80, 220))):
        x, y = pixel(point)
        draw.ellipse((x - 6, y - 6, x + 6, y + 6), fill=colour)
    return picture


def _map_window(scene: CompiledScene, centre: NDArray[np.float64], span_m: float, size: int) -> Image.Image:
    info = scene.info
    offsets = (np.arange(size) + 0.5) / size * span_m - span_m / 2
    columns = np.floor((centre[0] + offsets - info.grid_origin_m[0]) / info.grid_resolution_m).astype(int)
    rows = np.floor((centre[1] - offsets - info.grid_origin_m[1]) / info.grid_resolution_m).astype(int)
    height, width = scene.occupancy.shape
    inside = ((rows >= 0) & (rows < height))[:, None] & ((columns >= 0) & (columns < width))[None, :]
    cells = scene.occupancy[np.clip(rows, 0, height - 1)[:, None], np.clip(columns, 0, width - 1)[None, :]]
    grey = np.where(inside, np.where(cells > 0, 90, 245), 160).astype(np.uint8)
    return Image.fromarray(grey).convert("RGB")
