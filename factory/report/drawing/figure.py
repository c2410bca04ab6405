"""What a report consists of: exhibits, each with panels, a caption and tables. Values only."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from factory.report.data import ReportInput
from factory.report.drawing.canvas import Panel

__all__ = ["Drawer", "Exhibit", "Table"]


@dataclass(frozen=True)
class Table:
    """A table of the page; cells are text as it shall be read."""

    columns: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    title: str = ""


@dataclass(frozen=True)
class Exhibit:
    """One figure of the paper, drawn from this dataset."""

    name: str
    """Anchor on the page and beginning of its file names."""
    title: str
    source: str
    """The figure or table of the paper, or why it has none."""
    caption: str
    """What is seen, and from how many episodes or attempts."""
    panels: tuple[Panel, ...] = ()
    """Empty where there is nothing to show; the caption says so."""
    tables: tuple[Table, ...] = ()
    wide: bool = False
    """Whether the panels stand beside each other over the whole width."""


Drawer = Callable[[ReportInput], Exhibit]
