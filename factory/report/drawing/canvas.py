"""Draws panels and floor maps with matplotlib and returns SVG and PNG. The only module that imports matplotlib.

Deterministic: no dates, no random ids, and only the font that matplotlib contains. Writes no files.
"""

from __future__ import annotations

import io
import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from factory.html.palette import colour
from factory.visualize.floor_map import FloorMap
from schemas.dataset.rows import EpisodeSummary
from schemas.support.extras import missing_package

_BESIDE_IN, _ABOVE_IN = 0.45, 0.95
"""`_BESIDE_IN`: width of the labels of the y axis. `_ABOVE_IN`: height of the labels of the x axis, title and legend.
Both are in inches."""
_LEAST_IN, _MOST_IN = 1.5, 7.0


def floor_height_in(floor: FloorMap | None) -> float:
    """Returns the height of a panel in which the map fills the width, inches."""
    if floor is None:
        return WIDTH_IN
    west, east, south, north = floor.bounds_m
    height = (WIDTH_IN - _BESIDE_IN) * (north - south) / (east - west)
    return min(max(height, _LEAST_IN), _MOST_IN) + _ABOVE_IN


def draw_floor(axes: Axes, floor: FloorMap | None) -> None:
    """Draws the map with x to the right and y up, in metres; draws empty axes if there is no map."""
    axes.set_aspect("equal")
    axes.grid(visible=False)
    axes.set_xlabel("x, m")
    axes.set_ylabel("y, m")
    axes.spines[["left", "bottom"]].set_visible(False)
    axes.tick_params(length=2)
    if floor is None:
        axes.margins(0.1)
        return
    for level, (outlines, name) in enumerate(((floor.floor, "floor"), (floor.low, "low"), (floor.wall, "wall"))):
        fill_outlines(axes, outlines, colour(name), zorder=level / 10)
    west, east, south, north = floor.bounds_m
    axes.set_xlim(west, east)
    axes.set_ylim(south, north)


def draw_targets(axes: Axes, floor: FloorMap | None, episodes: list[EpisodeSummary]) -> None:
    """Marks all targets of the scene, and highlights the targets of the episodes."""
    if floor is not None:
        edge = {"facecolor": "none", "edgecolor": colour("muted"), "linewidth": 0.6}
        mark(axes, floor.targets_m, s=9, marker="D", zorder=2, **edge)
    if episodes:
        named = np.unique([(row.goal_x_m, row.goal_y_m) for row in episodes], axis=0)
        fill = {"color": colour("ink"), "edgecolor": colour("card"), "linewidth": 0.6}
        mark(axes, named, s=20, marker="D", zorder=4, label=f"target ({len(named)})", **fill)


def title_floor(axes: Axes, text: str) -> None:
    """Draws a title with space for one line of legend below it."""
    axes.set_title(text, pad=20)


def mark_paper(axes: Axes, points: ArrayLike, label: str = "paper") -> None:
    """Draws a hollow diamond at each point (K, 2)."""
    edge = {"facecolor": colour("card"), "edgecolor": colour("paper"), "linewidth": 1.6}
    mark(axes, points, marker="D", s=40, zorder=4, label=label, **edge)


try:
    import matplotlib as mpl
    from matplotlib.axes import Axes
    from matplotlib.axis import Axis
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure
    from matplotlib.patches import PathPatch
    from matplotlib.path import Path as Outline
    from matplotlib.ticker import MaxNLocator
except ImportError as error:
    raise missing_package("matplotlib", "the report") from error

__all__ = ["WIDTH_IN", "Axes", "Panel", "count_whole", "draw_panel", "fill_outlines", "mark", "write_legend"]

WIDTH_IN = 4.7
"""Width of every panel, inches; it fits a column of the page and a phone."""
_PNG_DPI = 200
_MOST_MARKS = 3000
"""Maximum number of vector markers in an SVG; more are rasterised."""
_PATH, _DECIMALS = re.compile(r' d="[^"]*"'), re.compile(r"-?\d+\.\d+")
_NO_METADATA = {"Date": None, "Creator": None, "Format": None, "Type": None}
_STYLE: dict[Any, Any] = {
    "axes.axisbelow": True,
    "axes.edgecolor": colour("muted"),
    "axes.facecolor": colour("card"),
    "axes.grid": True,
    "axes.labelcolor": colour("ink"),
    "axes.labelsize": 9,
    "axes.linewidth": 0.8,
    "axes.spines.right": False,
    "axes.spines.top": False,
    "axes.titlecolor": colour("ink"),
    "axes.titlelocation": "left",
    "axes.titlesize": 10,
    "axes.titleweight": "bold",
    "axes.unicode_minus": True,
    "figure.facecolor": colour("card"),
    "font.family": ["DejaVu Sans"],
    "font.size": 9,
    "grid.color": colour("line"),
    "grid.linewidth": 0.6,
    "legend.fontsize": 8.5,
    "legend.frameon": False,
    "legend.handlelength": 1.4,
    "legend.labelcolor": colour("ink"),
    "lines.linewidth": 1.6,
    "patch.linewidth": 0.8,
    "path.simplify": True,
    "savefig.facecolor": colour("card"),
    "svg.fonttype": "none",
    "text.color": colour("ink"),
    "xtick.color": colour("muted"),
    "xtick.labelcolor": colour("ink"),
    "xtick.labelsize": 8.5,
    "ytick.color": colour("muted"),
    "ytick.labelcolor": colour("ink"),
    "ytick.labelsize": 8.5,
}


@dataclass(frozen=True)
class Panel:
    """Drawing as SVG and PNG."""

    name: str
    """File name without suffix, unique within a report."""
    alt: str
    """Alternative text."""
    svg: str
    _draw_png: Callable[[], bytes] = field(repr=False, compare=False)

    @property
    def png(self) -> bytes:
        """PNG with the same content, drawn again at each access."""
        return self._draw_png()


def draw_panel(name: str, alt: str, paint: Callable[[Axes], None], height_in: float = 3.0) -> Panel:
    """Draws a panel.

    Args:
        name: file name without suffix.
        alt: alternative text.
        paint: function that draws on the axes.
        height_in: height of the drawing, inches; its width is `WIDTH_IN`.
    """
    style = {**_STYLE, "svg.hashsalt": name}
    with mpl.rc_context(style):
        figure = Figure(figsize=(WIDTH_IN, height_in), layout="constrained")
        FigureCanvasAgg(figure)
        paint(figure.add_subplot())
        figure.draw_without_rendering()
        figure.set_layout_engine(None)  # with a layout engine, matplotlib draws each file twice
        return Panel(name, alt, _as_svg(figure), lambda: _as_png(figure, style))


def write_legend(axes: Axes, columns: int = 3, **more: Any) -> None:
    """Draws the legend above the axes, if anything on them has a label."""
    if not axes.get_legend_handles_labels()[0]:
        return
    axes.legend(loc="lower left", bbox_to_anchor=(0, 1.0), ncols=columns, borderaxespad=0.2, columnspacing=1.2, **more)


def mark(axes: Axes, points: ArrayLike, **style: Any) -> None:
    """Draws markers at points (K, 2)."""
    places = np.asarray(points, np.float64).reshape(-1, 2)
    if len(places):
        axes.scatter(places[:, 0], places[:, 1], rasterized=len(places) > _MOST_MARKS, **style)


def count_whole(axis: Axis) -> None:
    """Restricts the ticks of an axis to integers."""
    axis.set_major_locator(MaxNLocator(integer=True, min_n_ticks=1))


def fill_outlines(axes: Axes, loops: Sequence[NDArray[np.float64]], fill: str, zorder: float) -> None:
    """Fills closed loops of points (K, 2) as one path with holes."""
    if loops:
        # a closed path repeats its first point, as matplotlib requires
        parts = [Outline(np.vstack([loop, loop[:1]]), closed=True) for loop in loops]
        whole = Outline.make_compound_path(*parts)
        axes.add_artist(PathPatch(whole, facecolor=fill, edgecolor="none", zorder=zorder))


def _as_svg(figure: Figure) -> str:
    buffer = io.StringIO()
    figure.savefig(buffer, format="svg", metadata=_NO_METADATA)
    text = buffer.getvalue()
    text = text[text.index("<svg") :]
    # remove group ids: they repeat between panels, but ids of a page must be unique; no element refers to them
    text = re.sub(r'<g id="[^"]*"', "<g", text)
    text = _PATH.sub(lambda match: _DECIMALS.sub(_shorten, match.group()), text)
    return text.replace("'DejaVu Sans'", "'DejaVu Sans', Verdana, 'Segoe UI', sans-serif")


def _shorten(match: re.Match[str]) -> str:
    """Rounds a coordinate to hundredths of a point, which is below screen resolution."""
    return f"{float(match.group()):.2f}".rstrip("0").rstrip(".")


def _as_png(figure: Figure, style: dict[Any, Any]) -> bytes:
    buffer = io.BytesIO()
    with mpl.rc_context(style):
        figure.savefig(buffer, format="png", dpi=_PNG_DPI, metadata={"Software": None})
    return buffer.getvalue()
