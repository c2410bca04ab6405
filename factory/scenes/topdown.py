"""Draws a top-down map of a scene: walls, connected floor, targets by category, spawn points.

The image is for viewing only; no program reads it.
"""

from __future__ import annotations

import colorsys
import io
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw

from schemas.scene import CompiledScene, Target
from schemas.support.numpy_types import Bools
from workers.geometry.grid import DISC_RADIUS_M

if TYPE_CHECKING:
    from factory.scenes.navigation.reach import Terrain

_FREE, _REACHABLE, _OCCUPIED, _HIDING = (225, 225, 220), (250, 250, 245), (120, 125, 140), (60, 62, 75)
_SPAWN = (40, 140, 60)


@dataclass(frozen=True)
class MapContent:
    """Content of a map."""

    name: str
    occupancy: NDArray[np.uint8]
    """(H, W) as in `CompiledScene`."""
    reachable: NDArray[np.uint8] | Bools
    """(H, W) non-zero on the connected floor."""
    origin_m: tuple[float, float]
    resolution_m: float
    targets: Sequence[Target]
    spawns: NDArray[np.float32]
    """(S, 2) metres."""

    @classmethod
    def of_scene(cls, scene: CompiledScene) -> MapContent:
        info = scene.info
        return cls(
            name=info.name,
            occupancy=scene.occupancy,
            reachable=scene.reachable,
            origin_m=info.grid_origin_m,
            resolution_m=info.grid_resolution_m,
            targets=info.targets,
            spawns=scene.spawns,
        )

    @classmethod
    def of_terrain(
        cls, name: str, terrain: Terrain, spawns: NDArray[np.float32], targets: Sequence[Target]
    ) -> MapContent:
        """Returns the map of a scene that is not compiled, with its candidates as targets."""
        grid = terrain.grid
        return cls(
            name=name,
            occupancy=grid.occupancy,
            reachable=terrain.floor,
            origin_m=grid.origin_m,
            resolution_m=grid.resolution_m,
            targets=targets,
            spawns=spawns,
        )


def draw_topdown(scene: CompiledScene, pixels_per_cell: int = 4) -> NDArray[np.uint8]:
    """Returns the map of a compiled scene; see `draw_map`."""
    return draw_map(MapContent.of_scene(scene), pixels_per_cell)


def draw_map(scene: MapContent, pixels_per_cell: int = 4) -> NDArray[np.uint8]:
    """Returns an RGB image (rows, columns, 3); north (y) is up.

    Args:
        scene: content of the map.
        pixels_per_cell: side of one grid cell, pixels.
    """
    picture = np.full((*scene.occupancy.shape, 3), _FREE, np.uint8)
    picture[scene.reachable > 0] = _REACHABLE
    picture[scene.occupancy == 1] = _OCCUPIED
    picture[scene.occupancy == 2] = _HIDING
    large = np.repeat(np.repeat(picture, pixels_per_cell, axis=0), pixels_per_cell, axis=1)
    image = Image.fromarray(large)
    pen = ImageDraw.Draw(image)
    scale = pixels_per_cell / scene.resolution_m
    origin = np.asarray(scene.origin_m)
    _draw_targets(pen, scene, origin, scale)
    radius = DISC_RADIUS_M * scale / 3
    for x, y in (scene.spawns - origin) * scale:
        pen.ellipse((x - radius, y - radius, x + radius, y + radius), fill=_SPAWN)
    _draw_legend(image, scene)
    return np.asarray(image)


def category_colour(category: str, categories: list[str]) -> tuple[int, int, int]:
    hue = categories.index(category) / max(len(categories), 1)
    red, green, blue = colorsys.hsv_to_rgb(hue, 0.85, 0.9)
    return round(red * 255), round(green * 255), round(blue * 255)


def _categories(scene: MapContent) -> list[str]:
    return sorted({target.category for target in scene.targets})


def _draw_targets(pen: ImageDraw.ImageDraw, scene: MapContent, origin: NDArray[np.float64], scale: float) -> None:
    categories = _categories(scene)
    for target in scene.targets:
        middle = (np.asarray(target.centroid_m[:2]) - origin) * scale
        half = np.asarray(target.size_m[:2]) * scale / 2
        colour = category_colour(target.category, categories)
        pen.rectangle((*(middle - half), *(middle + half)), outline=colour, width=2)
        pen.ellipse((*(middle - 3), *(middle + 3)), fill=colour)


def _draw_legend(image: Image.Image, scene: MapContent) -> None:
    """Flips the image to north up, then draws the category names."""
    image.paste(image.transpose(Image.Transpose.FLIP_TOP_BOTTOM))
    pen = ImageDraw.Draw(image)
    categories = _categories(scene)
    lines = [(scene.name, (0, 0, 0))] + [(name, category_colour(name, categories)) for name in categories]
    for row, (text, colour) in enumerate(lines):
        pen.text((6, 4 + 13 * row), text, fill=colour)


def encode_topdown(scene: CompiledScene) -> bytes:
    """Returns the map encoded as PNG."""
    return encode_map(MapContent.of_scene(scene))


def encode_map(scene: MapContent) -> bytes:
    """Returns a map encoded as PNG."""
    buffer = io.BytesIO()
    Image.fromarray(draw_map(scene)).save(buffer, "PNG")
    return buffer.getvalue()
