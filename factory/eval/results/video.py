"""Draws videos of evaluation episodes from their results: the camera image next to the map with the track.

Renders the recorded poses, ten per second; does not run the simulation again. Writes no files.
"""

from __future__ import annotations

import io
import math
from collections.abc import Iterator, Sequence
from fractions import Fraction

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw

from factory.eval.models.result import Attention, EpisodeResult
from factory.eval.results.compare import Pair
from factory.visualize.film import Rgb
from schemas.config import CameraConfig, TaskConfig
from schemas.measure import Goal
from schemas.scene import CompiledScene
from workers.geometry.pose import Pose
from workers.render import Renderer

FILM_RATE = Fraction(8)
"""Frame rate of the videos, pictures per second."""
FILM_CRF = 28
"""Constant rate factor of x264. A video takes about 10 kB per second at standstill and 60 kB per second while the
robot drives."""
_SIDE_PX = 320
_FRAMES = 36
_GAP_PX = 8
_POSTER_QUALITY = 80
_MARGIN_M = 1.2
_MARK_PX = 16
_MARK, _MARK_EDGE = (255, 0, 200), (255, 255, 255)
_FREE, _OCCUPIED, _UNKNOWN = 245, 110, 170
_TRACK, _START, _GOAL = (20, 80, 220), (20, 160, 60), (220, 30, 30)


def choose_failures(results: Sequence[EpisodeResult], count: int) -> list[EpisodeResult]:
    """Returns at most `count` failures in the order of the results; prefers failures of different kinds."""
    by_kind: dict[str, list[EpisodeResult]] = {}
    for row in results:
        if row.failure is not None:
            by_kind.setdefault(row.failure, []).append(row)
    queues, chosen = list(by_kind.values()), list[EpisodeResult]()
    while len(chosen) < count and any(queues):
        for rows in queues:
            if rows and len(chosen) < count:
                chosen.append(rows.pop(0))
    place = {id(row): number for number, row in enumerate(results)}
    return sorted(chosen, key=lambda row: place[id(row)])


def draw_frames(
    result: EpisodeResult,
    scene: CompiledScene,
    task: TaskConfig,
    renderer: Renderer,
    camera: CameraConfig,
    poses: int | None = None,
) -> Iterator[Rgb]:
    """Yields at most 36 pictures (320, 640, 3) of an episode, spread evenly over its track.

    Args:
        result: Result with the track.
        scene: Scene of the episode.
        task: Success measure and radius.
        renderer: Open renderer for the camera images.
        camera: Camera of the robot.
        poses: Number of poses of the time axis, if it is longer than the track; at its end, the last pose is repeated.
    """
    target = scene.info.target(result.target_id)
    renderer.load(scene, camera)
    length = poses or len(result.track)
    board = _Map(scene, result, Goal.of(target, task))
    # renders the recorded track again, because only a few failures are filmed, and filming every drive is slow
    for time in np.linspace(0, length - 1, min(_FRAMES, length)).round().astype(int):
        row = min(int(time), len(result.track) - 1)
        pose = result.track[row]
        rgb = renderer.render(Pose.planar(*pose, z=scene.info.floor_height_m)).rgb
        view = Image.fromarray(rgb).resize((_SIDE_PX, _SIDE_PX), Image.Resampling.BOX)
        if result.attention:
            _mark(view, result.attention[row])
        yield np.hstack((np.asarray(view), np.asarray(board.draw(row))))


def _mark(view: Image.Image, attention: Attention | None) -> None:
    """Draws a circle where the policy located the named object; the surer the policy, the thicker the line."""
    if attention is None:
        return
    column, row, confidence = attention
    x, y = column * _SIDE_PX, row * _SIDE_PX
    box = (x - _MARK_PX, y - _MARK_PX, x + _MARK_PX, y + _MARK_PX)
    pen = ImageDraw.Draw(view)
    width = 1 + round(3 * confidence)
    pen.ellipse(box, outline=_MARK_EDGE, width=width + 2)
    pen.ellipse(
        tuple(side + inset for side, inset in zip(box, (1, 1, -1, -1), strict=True)), outline=_MARK, width=width
    )


def draw_pair(
    pair: Pair, scene: CompiledScene, task: TaskConfig, renderer: Renderer, camera: CameraConfig
) -> Iterator[Rgb]:
    """Yields pictures (648, 640, 3) of one episode of two policies on one time axis, the first policy above.

    Args:
        pair: Results with the tracks.
        scene: Scene of the episode.
        task: Success measure and radius.
        renderer: Open renderer for the camera images.
        camera: Camera of the robot.
    """
    poses = max(len(result.track) for result in pair)
    films = [list(draw_frames(result, scene, task, renderer, camera, poses)) for result in pair]
    gap = np.full((_GAP_PX, 2 * _SIDE_PX, 3), _FREE, np.uint8)
    for one, other in zip(*films, strict=True):
        yield np.vstack((one, gap, other))


def draw_poster(picture: Rgb) -> bytes:
    """Returns a picture of a video as JPEG."""
    out = io.BytesIO()
    Image.fromarray(picture).save(out, "JPEG", quality=_POSTER_QUALITY)
    return out.getvalue()


class _Map:
    """Map of the scene around a track; x to the right, y up."""

    def __init__(self, scene: CompiledScene, result: EpisodeResult, goal: Goal) -> None:
        self._track = np.array([pose[:2] for pose in result.track])
        self._yaws = [pose[2] for pose in result.track]
        self._goal = np.asarray(goal.centre_m)
        points = np.vstack((self._track, self._goal))
        self._centre = (points.min(axis=0) + points.max(axis=0)) / 2
        span_m = float(np.ptp(points, axis=0).max()) + 2 * _MARGIN_M
        self._px_per_m = _SIDE_PX / span_m
        self._outline = [self._pixel(point) for point in goal.outline()]
        self._floor = self._draw_floor(scene, span_m)

    def draw(self, row: int) -> Image.Image:
        """Returns the map with the track up to row `row`."""
        picture = self._floor.copy()
        pen = ImageDraw.Draw(picture)
        gx, gy = self._pixel(self._goal)
        pen.line(self._outline, fill=_GOAL, width=2)
        pen.ellipse((gx - 4, gy - 4, gx + 4, gy + 4), fill=_GOAL)
        line = [self._pixel(point) for point in self._track[: row + 1]]
        if len(line) > 1:
            pen.line(line, fill=_TRACK, width=3)
        sx, sy = line[0]
        pen.ellipse((sx - 4, sy - 4, sx + 4, sy + 4), fill=_START)
        x, y = line[-1]
        dx, dy = 14 * math.cos(self._yaws[row]), -14 * math.sin(self._yaws[row])
        pen.ellipse((x - 6, y - 6, x + 6, y + 6), fill=_TRACK)
        pen.line((x, y, x + dx, y + dy), fill=_TRACK, width=3)
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
