"""Draws floor plans of scenes as SVG: walls, obstacles and floor as paths in metres, north up. Keeps recent ones."""

from __future__ import annotations

import threading
from collections import OrderedDict
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any, NamedTuple

from factory.dataset.packages import ScenePackage
from factory.html.palette import css_variables, reason_colour
from factory.visualize.floor_map import map_of
from schemas.scene import SceneInfo

_KEPT = 16


class FloorMark(NamedTuple):
    """Failure on a floor plan."""

    reason: str
    """Reason of the failure, which decides the colour."""
    xy_m: tuple[float, float]
    """Location x, y, metres."""
    is_exact: bool
    """Whether `xy_m` is the location of the robot; otherwise, it is that of the target, and the mark is a ring."""


@dataclass(frozen=True)
class Floor:
    """Floor plan of a scene."""

    info: SceneInfo
    """Metadata of the scene."""
    west: float
    """Smallest x, metres."""
    north: float
    """Largest y, metres; the map's vertical axis is -y."""
    width: float
    """Extent along x, metres."""
    height: float
    """Extent along y, metres."""
    paths: tuple[tuple[str, str], ...]
    """Class and path data of floor, low obstacles and walls."""
    spawns: tuple[tuple[float, float], ...]
    """Surveyed start points x, y, metres."""

    @property
    def view_box(self) -> str:
        """View box of the map in metres."""
        return f"{self.west:.2f} {-self.north:.2f} {self.width:.2f} {self.height:.2f}"

    def image(self, view_box: str = "", marks: Iterable[FloorMark] = ()) -> str:
        """Returns the plan as a separate SVG image that follows the colour scheme.

        Args:
            view_box: shown part as x, -y, width and height in metres; the whole plan if empty.
            marks: failures to draw.
        """
        style = (
            f":root {{ {css_variables(dark=False)} }} @media (prefers-color-scheme: dark) {{ :root "
            f"{{ {css_variables(dark=True)} }} }} .floor {{ fill: var(--floor) }} .low {{ fill: var(--low) }} "
            ".wall { fill: var(--wall) }"
        )
        paths = "".join(f'<path class="{name}" fill-rule="evenodd" d="{data}"/>' for name, data in self.paths)
        head = f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="{view_box or self.view_box}">'
        dots = "".join(_dot(*mark, radius=max(self.width, self.height) / 120) for mark in marks)
        return f"{head}<style>{style}</style>{paths}{dots}</svg>"


class FloorStore:
    """Floor plans of the most recently used scenes; thread-safe."""

    def __init__(self) -> None:
        self._kept: OrderedDict[ScenePackage, Floor] = OrderedDict()
        self._lock = threading.Lock()

    def of(self, package: ScenePackage) -> Floor:
        """Returns the floor plan of a scene.

        Raises:
            ArchiveCorrupt: the package is missing.
            InvalidBundle: the package is damaged.
        """
        with self._lock:  # drawing takes a second; other requests for the same plan wait
            if package not in self._kept:
                self._kept[package] = _draw(package)
                while len(self._kept) > _KEPT:
                    self._kept.popitem(last=False)
            self._kept.move_to_end(package)
            return self._kept[package]


def _draw(package: ScenePackage) -> Floor:
    scene = package.geometry()
    drawn = map_of(scene)
    west, east, south, north = drawn.bounds_m
    layers = (("floor", drawn.floor), ("low", drawn.low), ("wall", drawn.wall))
    paths = tuple((name, "".join(map(_path, outlines))) for name, outlines in layers)
    spawns = tuple((float(x), float(y)) for x, y in scene.spawns[:2000])
    return Floor(scene.info, west, north=north, width=east - west, height=north - south, paths=paths, spawns=spawns)


def _dot(reason: str, xy_m: tuple[float, float], is_exact: bool, radius: float) -> str:
    colour = f"var(--{reason_colour(reason)})"
    return (
        f'<circle cx="{xy_m[0]:.2f}" cy="{-xy_m[1]:.2f}" r="{radius:.3f}" stroke-width="{radius / 3:.3f}" '
        f'stroke="{colour}" fill="{colour if is_exact else "none"}"/>'
    )


def _path(outline: Any) -> str:
    return "M" + "L".join(f"{x:.2f} {-y:.2f}" for x, y in outline.tolist()) + "Z"
