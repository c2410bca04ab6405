"""Renders images of a compiled scene: map, views at eye height and from the robot's camera, contact sheets."""

from __future__ import annotations

import os
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from PIL import Image

from factory.scenes.pictures.sheet import draw_sheet, known_colours, variants
from factory.scenes.pictures.viewpoints import EYE, Viewpoint, best_views
from factory.scenes.topdown import encode_topdown
from schemas.encoding.image_sizes import FRAME_SIZE_PX
from schemas.scene import CompiledScene
from schemas.terms import RendererKind
from workers.render import Renderer
from workers.render.choose import open_renderer

__all__ = ["Wanted", "draw_scene"]

_SMALL_PX, _SHEET_PX = 96, 400
_FINE = 2
"""Supersampling factor of the views at eye height."""


@dataclass(frozen=True)
class Wanted:
    """Number of images of each kind."""

    views: int = 6
    """Number of views at a person's eye height."""
    robot_views: int = 4
    """Number of views from the robot's camera."""
    colours: int = 0
    """Number of targets with a known colour on the colour sheet."""


def draw_scene(scene: CompiledScene, folder: Path, wanted: Wanted, renderer: RendererKind) -> Iterator[Path]:
    """Writes `map.png`, `eye_00.png`, ..., `robot_00.png`, ..., `categories.png` and `colours.png`; yields each path.

    Args:
        scene: compiled scene.
        folder: output directory; created if missing.
        wanted: number of images of each kind.
        renderer: renderer to use.
    """
    os.environ.setdefault("LP_NUM_THREADS", "0")
    folder.mkdir(parents=True, exist_ok=True)
    chart = folder / "map.png"
    chart.write_bytes(encode_topdown(scene))
    yield chart
    with open_renderer(renderer, _SMALL_PX) as eye:
        standing = best_views(eye, scene, EYE, wanted.views)
        driving = best_views(eye, scene, None, wanted.robot_views)
    with open_renderer(renderer, _FINE * FRAME_SIZE_PX) as eye:
        for number, view in enumerate(standing):
            yield _save(_fine(eye, scene, view), folder / f"eye_{number:02d}.png")
    with open_renderer(renderer) as eye:
        for number, view in enumerate(driving):
            eye.load(scene, view.camera)
            yield _save(Image.fromarray(eye.render(view.pose).rgb), folder / f"robot_{number:02d}.png")
    with open_renderer(renderer, _SHEET_PX) as eye:
        yield _save(draw_sheet(eye, scene, variants(scene.info.targets)), folder / "categories.png")
        if wanted.colours:
            sample = known_colours(scene.info.targets, wanted.colours, np.random.default_rng(0))
            yield _save(draw_sheet(eye, scene, sample, in_place=True), folder / "colours.png")


def _fine(eye: Renderer, scene: CompiledScene, view: Viewpoint) -> Image.Image:
    eye.load(scene, view.camera)
    return Image.fromarray(eye.render(view.pose).rgb).resize((FRAME_SIZE_PX,) * 2, Image.Resampling.LANCZOS)


def _save(image: Image.Image, path: Path) -> Path:
    image.save(path)
    return path
