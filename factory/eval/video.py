"""Short videos of drives for people: the camera's view beside the map with the track so far, drawn again from results.

The simulation is not run again: poses are taken from the result's track, ten a second.
"""

from __future__ import annotations

import io
import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw

from factory.eval.result import EpisodeResult
from schemas.config import CameraConfig
from schemas.scene import CompiledScene, Target
from workers.pose import Pose
from workers.render import Renderer

__all__ = ["choose_failures", "draw_video"]

_SIDE_PX = 200
_FRAMES = 36
_LASTS_MS, _LAST_MS = 120, 900
_MARGIN_M = 1.2
_FREE, _OCCUPIED, _UNKNOWN = 245, 110, 170
_TRACK, _START, _GOAL = (20, 80, 220), (20, 160, 60), (220, 30, 30)


def choose_failures(results: Sequence[EpisodeResult], count: int) -> list[EpisodeResult]:
    """Returns at most `count` failures, one of each way to end in turn, in the order of the results."""
    by_end: dict[str, list[EpisodeResult]] = {}
    for row in results:
        if not row.success:
            by_end.setdefault(row.end, []).append(row)
    queues, chosen = list(by_end.values()), list[EpisodeResult]()
    while len(chosen) < count and any(queues):
        for rows in queues:
            if rows and len(chosen) < count:
                chosen.append(rows.pop(0))
    place = {id(row): number for number, row in enumerate(results)}
    return sorted(chosen, key=lambda row: place[id(row)])


def draw_video(
    result: EpisodeResult, scene: CompiledScene, radius_m: float, renderer: Renderer, camera: CameraConfig
) -> bytes:
    """Returns an animated WebP of a drive.

    Args:
        result: with its track.
        scene: where it took place.
        radius_m: of success.
        renderer: open; shows the camera's view.
        camera: of the robot.
    """
    target = scene.info.target(result.target_id)
    renderer.load(scene, camera)
    count = min(_FRAMES, len(result.track))
    rows = np.linspace(0, len(result.track) - 1, count).round().astype(int)
    board = _Map(scene, result, target, radius_m)
    frames = []
    for row in rows:
        pose = result.track[int(row)]
        rgb = renderer.render(Pose.planar(*pose, z=scene.info.floor_height_m)).rgb
        picture = Image.new("RGB", (2 * _SIDE_PX, _SIDE_PX))
        view = Image.fromarray(rgb).resize((_SIDE_PX, _SIDE_PX), Image.Resampling.BOX)
        picture.paste(view, (0, 0))
        picture.paste(board.draw(int(row)), (_SIDE_PX, 0))
        frames.append(picture)
    out = io.BytesIO()
    lasts = [_LASTS_MS] * (len(frames) - 1) + [_LAST_MS]
    frames[0].save(out, "WEBP", save_all=True, append_images=frames[1:], duration=lasts, loop=0, quality=55, method=2)
    return out.getvalue()


class _Map:
    """The scene from above around a track; x to the right, y up."""

    def __init__(self, scene: CompiledScene, result: EpisodeResult, target: Target, radius_m: float) -> None:
        self._track = np.array([pose[:2] for pose in result.track])
        self._yaws = [pose[2] for pose in result.track]
        self._goal = np.asarray(target.centroid_m[:2])
        points = np.vstack((self._track, self._goal))
        self._centre = (points.min(axis=0) + points.max(axis=0)) / 2
        span_m = float(np.ptp(points, axis=0).max()) + 2 * _MARGIN_M
        self._px_per_m = _SIDE_PX / span_m
        self._radius_px = radius_m * self._px_per_m
        self._floor = self._draw_floor(scene, span_m)

    def draw(self, row: int) -> Image.Image:
        """Returns the map with the track up to a row."""
        picture = self._floor.copy()
        pen = ImageDraw.Draw(picture)
        gx, gy = self._pixel(self._goal)
        box = (gx - self._radius_px, gy - self._radius_px, gx + self._radius_px, gy + self._radius_px)
        pen.ellipse(box, outline=_GOAL)
        pen.ellipse((gx - 3, gy - 3, gx + 3, gy + 3), fill=_GOAL)
        line = [self._pixel(point) for point in self._track[: row + 1]]
        if len(line) > 1:
            pen.line(line, fill=_TRACK, width=2)
        sx, sy = line[0]
        pen.ellipse((sx - 3, sy - 3, sx + 3, sy + 3), fill=_START)
        x, y = line[-1]
        dx, dy = 9 * math.cos(self._yaws[row]), -9 * math.sin(self._yaws[row])
        pen.ellipse((x - 4, y - 4, x + 4, y + 4), fill=_TRACK)
        pen.line((x, y, x + dx, y + dy), fill=_TRACK, width=2)
        return picture

    def _pixel(self, xy: NDArray[np.float64]) -> tuple[float, float]:
        x, y = (xy - self._centre) * self._px_per_m
        return _SIDE_PX / 2 + float(x), _SIDE_PX / 2 - float(y)

    def _draw_floor(self, scene: CompiledScene, span_m: float) -> Image.Image:
        info = scene.info
        offsets = (np.arange(_SIDE_PX) + 0.5) / _SIDE_PX * span_m - span_m / 2
        origin = np.asarray(info.grid_origin_m)
        columns = np.floor((self._centre[0] + offsets - origin[0]) / info.grid_resolution_m).astype(int)
        rows = np.floor((self._centre[1] - offsets - origin[1]) / info.grid_resolution_m).astype(int)
        height, width = scene.occupancy.shape
        is_inside = ((rows >= 0) & (rows < height))[:, None] & ((columns >= 0) & (columns < width))[None, :]
        cells = scene.occupancy[np.clip(rows, 0, height - 1)[:, None], np.clip(columns, 0, width - 1)[None, :]]
        grey = np.where(is_inside, np.where(cells > 0, _OCCUPIED, _FREE), _UNKNOWN).astype(np.uint8)
        return Image.fromarray(grey).convert("RGB")
