"""Draws contact sheets and the panels of videos: depth and ids as colours, the track on the map. Writes no files."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray
from PIL import Image, ImageDraw, ImageFont

from schemas.bundle import BundleReader
from schemas.episode import Rollout
from schemas.measure import Goal
from schemas.scene import CompiledScene

DEPTH_SHOWN_M = 10.0
"""Depth at the dark end of the colour map, metres."""
_LEAST_SPAN_M = 8.0
_RIM_M = 3.0
_DEPTH_COLOURS = ((252, 253, 191), (254, 159, 109), (222, 73, 104), (140, 41, 129), (59, 15, 112), (8, 8, 30))
"""Colour map from near (bright) to far (dark), interpolated linearly."""
_TARGET, _TRACK, _START = (230, 30, 30), (20, 80, 220), (20, 160, 60)
Rgb = NDArray[np.uint8]
_TILE_PX = 240
_MARGIN_PX = 8
_HEAD_SHARE, _WORDS_SHARE, _FACTS_SHARE = 1 / 30, 1 / 80, 1 / 100
"""Heights of the header and of its two text lines, as shares of the sheet's width."""


def _depth_table() -> Rgb:
    places = np.linspace(0, 255, len(_DEPTH_COLOURS))
    channels = [np.interp(np.arange(256), places, column) for column in zip(*_DEPTH_COLOURS, strict=True)]
    return np.stack(channels, axis=1).astype(np.uint8)


_TABLE = _depth_table()


def show_depth(depth: NDArray[np.float32]) -> Rgb:
    """Returns depth (H, W) in metres as colour (H, W, 3): near is bright; pixels without a hit are black."""
    shade = np.sqrt(np.clip(depth / DEPTH_SHOWN_M, 0, 1))  # more resolution for near depths, which are frequent
    colours: Rgb = _TABLE.take((255 * shade).astype(np.uint8), axis=0)
    colours[depth == 0] = 0
    return colours


def show_ids(ids: NDArray[np.uint16], target: int) -> Rgb:
    """Returns ids of any shape as colours (..., 3); an id has the same colour in all episodes, the target is red."""
    mixed = ids.astype(np.uint32) * np.uint32(2654435761)
    colours = np.stack([mixed >> 24, mixed >> 16, mixed >> 8], axis=-1).astype(np.uint8) // 2 + 40
    colours[ids == 0] = 0
    colours[ids == target] = (255, 40, 40)
    return colours


def describe_error(rollout: Rollout) -> str:
    """Returns the navigation error by both measures, if the episode records both."""
    if rollout.final_surface_m is None:
        return f"NE {rollout.final_ne_m:.3f} m"
    return f"NE {rollout.final_ne_m:.3f} m to the centre, {rollout.final_surface_m:.3f} m to the footprint"


class TrackMap:
    """Part of the scene's floor plan, +y up, on which the track of an episode is drawn.

    Args:
        episode: Bundle of the episode.
        scene: Scene in which the episode was recorded.
        size: Side of the square picture, pixels.
    """

    def __init__(self, episode: BundleReader, scene: CompiledScene, size: int) -> None:
        self._track = episode.arrays.poses[:, :2]
        self._goal = np.array(episode.meta.target_centroid_m[:2])
        points = np.vstack([self._track, self._goal])
        self._centre = (points.min(axis=0) + points.max(axis=0)) / 2
        span_m = max(float(np.ptp(points, axis=0).max()) + _RIM_M, _LEAST_SPAN_M)
        self._size, self._scale = size, size / span_m
        self._floor = _window(scene, self._centre, span_m, size)
        self._outline = Goal.of_episode(episode.meta).outline()

    def draw(self, steps: int) -> Image.Image:
        """Returns the map with the first `steps` poses of the track, the start, the goal and its success region."""
        picture = self._floor.copy()
        pen = ImageDraw.Draw(picture)
        track = [self._pixel(point) for point in self._track[: max(1, steps)]]
        width = max(2, self._size // 240)
        if len(track) > 1:
            pen.line(track, fill=_TRACK, width=width)
        gx, gy = self._pixel(self._goal)
        dot = max(4.0, self._size / 120)
        pen.line([self._pixel(point) for point in self._outline], fill=_TARGET, width=width)
        for (x, y), colour in (((gx, gy), _TARGET), (track[0], _START), (track[-1], _TRACK)):
            pen.ellipse((x - dot, y - dot, x + dot, y + dot), fill=colour)
        return picture

    def _pixel(self, xy: ArrayLike) -> tuple[float, float]:
        x, y = (np.asarray(xy, float) - self._centre) * self._scale
        return self._size / 2 + float(x), self._size / 2 - float(y)


def _window(scene: CompiledScene, centre: NDArray[np.float64], span_m: float, size: int) -> Image.Image:
    info = scene.info
    offsets = (np.arange(size) + 0.5) / size * span_m - span_m / 2
    columns = np.floor((centre[0] + offsets - info.grid_origin_m[0]) / info.grid_resolution_m).astype(int)
    rows = np.floor((centre[1] - offsets - info.grid_origin_m[1]) / info.grid_resolution_m).astype(int)
    height, width = scene.occupancy.shape
    inside = ((rows >= 0) & (rows < height))[:, None] & ((columns >= 0) & (columns < width))[None, :]
    cells = scene.occupancy[np.clip(rows, 0, height - 1)[:, None], np.clip(columns, 0, width - 1)[None, :]]
    grey = np.where(inside, np.where(cells > 0, 90, 245), 160).astype(np.uint8)
    return Image.fromarray(grey).convert("RGB")


def draw_contact_sheet(
    episode: BundleReader, scene: CompiledScene, columns: int = 6, instruction: str | None = None
) -> Image.Image:
    """Returns a contact sheet: three rows of frames from start to end, the track on the map, and the instruction.

    Args:
        episode: Bundle of the episode.
        scene: Scene in which the episode was recorded, for the map.
        columns: Number of frames in a row.
        instruction: Instruction in the header; `None` is the recorded instruction.
    """
    steps = np.linspace(0, episode.length - 1, columns).round().astype(int)
    rows = [
        [episode.rgb(t) for t in steps],
        [show_depth(episode.depth(t)) for t in steps],
        [show_ids(episode.ids(t), episode.meta.target_instance_id) for t in steps],
    ]
    track = TrackMap(episode, scene, 3 * _TILE_PX).draw(episode.length)
    width = columns * _TILE_PX + track.width
    head = round(width * _HEAD_SHARE)
    sheet = Image.new("RGB", (width, head + 3 * _TILE_PX), "white")
    for row, tiles in enumerate(rows):
        for column, tile in enumerate(tiles):
            small = Image.fromarray(tile).resize((_TILE_PX, _TILE_PX), Image.Resampling.BILINEAR)
            sheet.paste(small, (column * _TILE_PX, head + row * _TILE_PX))
    sheet.paste(track, (columns * _TILE_PX, head))
    _write_head(sheet, episode, instruction or episode.meta.instruction)
    return sheet


def _write_head(sheet: Image.Image, episode: BundleReader, instruction: str) -> None:
    job, rollout = episode.meta.job, episode.meta.rollout
    words = f"{episode.episode_id}  {job.scene}  {job.split}  {job.tier}  {instruction}"
    facts = (
        f"{job.target_id} ({job.colour})  attempt {job.attempt}  {rollout.num_steps} steps  "
        f"start {rollout.spawn_dist_m:.2f} m  TL {rollout.trajectory_length_m:.2f} m  {describe_error(rollout)}"
    )
    _write_line(sheet, 0.28, words, _WORDS_SHARE)
    _write_line(sheet, 0.72, facts, _FACTS_SHARE)


def _write_line(sheet: Image.Image, middle: float, text: str, share: float) -> None:
    """Writes a line of the header; reduces the font size where the text is wider than the sheet."""
    draw = ImageDraw.Draw(sheet)
    size = sheet.width * share
    over = draw.textlength(text, ImageFont.load_default(size)) / (sheet.width - 2 * _MARGIN_PX)
    font = ImageFont.load_default(size / max(1.0, over))
    draw.text((_MARGIN_PX, middle * sheet.width * _HEAD_SHARE), text, fill="black", font=font, anchor="lm")
