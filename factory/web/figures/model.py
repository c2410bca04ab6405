"""Models of the drawn figures, and of the messages of the process that draws them. Data only."""

from __future__ import annotations

from pydantic import Field

from schemas.base import Model


class FigureCard(Model):
    """Figure of the report, for the page."""

    name: str
    title: str
    caption: str
    panels: tuple[tuple[str, str], ...]
    """Name and description of each drawing."""


class DrawnStatistics(Model):
    """Figures of a dataset."""

    cards: tuple[FigureCard, ...]
    """Figures in the order of the report."""
    images: dict[str, str]
    """SVG by name of the drawing."""
    key: str
    """SHA-256 of the tables, the code of the figures, the type of the renderer and the limit of opened episodes."""
    episodes: int = Field(ge=0)
    """Number of episodes in the tables."""
    opened: int = Field(ge=0)
    """Number of episodes whose files were read for tracks, actions and frames."""
    is_complete: bool
    """Whether the figures are based on all episodes that the report would open."""


class Message(Model):
    """Line that the drawing process writes."""

    done: int = 0
    """Number of episodes read."""
    total: int = 0
    """Number of episodes to read; 0 while the tables are read."""
    drawn: DrawnStatistics | None = None
    """Figures, when they are drawn."""
    trouble: str = ""
    """Reason why the figures cannot be drawn."""
