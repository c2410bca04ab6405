"""Models of the figures of a report: panels, caption and tables. Data only."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from factory.report.data import ReportInput
from factory.report.drawing.canvas import Panel


@dataclass(frozen=True)
class Table:
    """Table of the page; cells are formatted text."""

    columns: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    title: str = ""


@dataclass(frozen=True)
class Figure:
    """Figure of the paper, drawn from the dataset."""

    name: str
    """Anchor on the page and prefix of the file names."""
    title: str
    source: str
    """Corresponding figure or table of the paper, or a note that the paper has none."""
    caption: str
    """Caption, with the number of episodes or attempts."""
    panels: tuple[Panel, ...] = ()
    """Panels; empty without data, which the caption then states."""
    tables: tuple[Table, ...] = ()
    wide: bool = False
    """Whether the panels use the full width of the page, side by side."""


DrawFunction = Callable[[ReportInput], Figure]
