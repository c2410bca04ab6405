"""Draws the marker of published values, which is the same in all figures."""

from __future__ import annotations

from numpy.typing import ArrayLike

from factory.html.palette import colour
from factory.report.drawing.canvas import Axes, mark


def mark_paper(axes: Axes, points: ArrayLike, label: str = "paper") -> None:
    """Draws a hollow diamond at each point (K, 2)."""
    edge = {"facecolor": colour("card"), "edgecolor": colour("paper"), "linewidth": 1.6}
    mark(axes, points, marker="D", s=40, zorder=4, label=label, **edge)
