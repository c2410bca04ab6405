"""Computes the figures of the report in one background thread and keeps those of the current dataset."""

from __future__ import annotations

import re
import threading
from dataclasses import dataclass
from typing import TYPE_CHECKING

from factory.dataset.reader import Dataset
from factory.html.palette import css_variables, with_variables
from schemas.errors import FactoryError

if TYPE_CHECKING:
    from factory.report.drawing.figure import Figure


@dataclass(frozen=True)
class FigureCard:
    """Figure of the report, for the page."""

    name: str
    title: str
    caption: str
    panels: tuple[tuple[str, str], ...]
    """Name and description of each drawing."""


@dataclass(frozen=True)
class DrawnStatistics:
    """Figures of a dataset."""

    cards: tuple[FigureCard, ...]
    """Figures in the order of the report."""
    images: dict[str, str]
    """SVG by name of the drawing."""
    trouble: str = ""
    """Reason why the figures cannot be drawn; empty if they were drawn."""


class StatisticsStore:
    """Figures of the current version of a dataset; thread-safe."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._dataset: Dataset | None = None
        self._drawn: DrawnStatistics | None = None

    def of(self, dataset: Dataset) -> DrawnStatistics | None:
        """Returns the figures of a dataset; `None` while they are being drawn."""
        with self._lock:
            if self._dataset is not dataset:
                self._dataset, self._drawn = dataset, None
                threading.Thread(target=self._draw, args=(dataset,), name="figures", daemon=True).start()
            return self._drawn

    def _draw(self, dataset: Dataset) -> None:
        try:
            drawn = _draw_all(dataset)
        except FactoryError as error:
            drawn = DrawnStatistics((), {}, str(error))
        except Exception as error:
            with self._lock:
                self._drawn = DrawnStatistics((), {}, f"the figures cannot be drawn: {error!r}")
            raise
        with self._lock:
            if self._dataset is dataset:
                self._drawn = drawn


def _draw_all(dataset: Dataset) -> DrawnStatistics:
    from factory.report.figures.registry import DRAW_FUNCTIONS  # with matplotlib, which takes half a second
    from factory.report.gather import gather

    material = gather(dataset.root, samples=0)
    figures = [figure for draw in DRAW_FUNCTIONS if (figure := draw(material)).panels]
    images = {panel.name: _themed(panel.svg) for figure in figures for panel in figure.panels}
    return DrawnStatistics(tuple(map(_card, figures)), images)


def _card(figure: Figure) -> FigureCard:
    return FigureCard(
        figure.name, figure.title, figure.caption, tuple((panel.name, panel.alt) for panel in figure.panels)
    )


def _themed(svg: str) -> str:
    """Returns a drawing as a separate image that follows the colour scheme."""
    style = (
        f"<style>:root {{ {css_variables(dark=False)} }} @media (prefers-color-scheme: dark) {{ :root "
        f"{{ {css_variables(dark=True)} }} }}</style>"
    )
    return re.sub(r"(<svg [^>]*>)", lambda found: found[1] + style, with_variables(svg), count=1)
