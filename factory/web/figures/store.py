"""Keeps the figures of a dataset; starts the process that draws them, one at a time."""

from __future__ import annotations

import os
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass, replace

from pydantic import Field

from factory.dataset.reader import Dataset
from schemas.base import Model
from schemas.support.child import child_environment, python_module
from schemas.support.child_process import ChildProcess, Ended
from schemas.support.closing import Closing


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


_MOST_MESSAGE_BYTES = 1 << 28
_SHARE = 3
"""After a drawing, the pause is this multiple of its wall time, so a run on the same machine is not slowed."""


@dataclass(frozen=True)
class StatisticsState:
    """Figures that can be shown, and the progress of newer figures."""

    drawn: DrawnStatistics | None = None
    """Newest figures; `None` before the first ones are drawn."""
    trouble: str = ""
    """Reason why newer figures cannot be drawn; empty if they can."""
    is_drawing: bool = False
    """Whether newer figures are being drawn."""
    done: int = 0
    """Number of episodes read for the newer figures."""
    total: int = 0
    """Number of episodes to read for the newer figures; 0 while the tables are read."""
    wait_s: float = 0.0
    """Time until newer figures may be drawn, seconds; 0 if the figures are those of the current tables."""


class StatisticsStore(Closing):
    """Figures of a dataset; thread-safe. A request never waits for a drawing.

    Args:
        place: directory or URL of the dataset.
        clock: function that returns the time, seconds.
    """

    def __init__(self, place: str, clock: Callable[[], float] = time.monotonic) -> None:
        self._place, self._clock = place, clock
        self._lock = threading.Lock()
        self._dataset: Dataset | None = None
        self._state = StatisticsState()
        self._next_s = -float("inf")
        self._is_busy = False
        self._process = ChildProcess(Message.model_validate_json, stderr="inherit", max_line_bytes=_MOST_MESSAGE_BYTES)
        self._thread: threading.Thread | None = None

    def of(self, dataset: Dataset) -> StatisticsState:
        """Returns the newest figures; starts to draw those of `dataset` if it has changed and none are being drawn."""
        with self._lock:
            if self._dataset is dataset or self._is_busy:
                return self._state
            wait_s = self._next_s - self._clock()
            if wait_s > 0:
                return replace(self._state, wait_s=wait_s)
            self._dataset, self._is_busy = dataset, True
            self._state = StatisticsState(self._state.drawn, is_drawing=True)
            command = python_module("factory.web.figures.process", self._place)
            self._process.start(command, child_environment(os.environ))
            self._thread = threading.Thread(target=self._read, name="figures", daemon=True)
            self._thread.start()
            return self._state

    def close(self) -> None:
        """Ends the drawing process."""
        self._process.kill()
        if self._thread is not None:
            self._thread.join()

    def _read(self) -> None:
        begin_s = self._clock()
        while not isinstance(message := self._process.wait(), Ended):
            self._take(message)
        code = message.status
        failure = f"the figures cannot be drawn: the drawing process ended with code {code}; see the log of the server"
        with self._lock:
            trouble = self._state.trouble or ("" if code == 0 else failure)
            self._state = StatisticsState(self._state.drawn, trouble)
            self._is_busy = False
            self._next_s = self._clock() + _SHARE * (self._clock() - begin_s)

    def _take(self, message: Message) -> None:
        with self._lock:
            drawn, is_last = message.drawn or self._state.drawn, message.drawn is not None and message.drawn.is_complete
            self._state = StatisticsState(
                drawn, message.trouble, is_drawing=not is_last, done=message.done, total=message.total
            )
