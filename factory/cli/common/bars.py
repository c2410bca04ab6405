"""Progress bars on stderr that fit the terminal; in a log file, a line a minute. The only user of rich's `Progress`."""

from __future__ import annotations

import time
from collections.abc import Iterable, Iterator
from dataclasses import replace
from typing import Any

from rich.console import Console, RenderableType
from rich.measure import Measurement
from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    Progress,
    ProgressColumn,
    Task,
    TaskID,
    TextColumn,
    TimeElapsedColumn,
)
from rich.table import Column, Table
from rich.text import Text

from factory.cli.common.output import stderr

__all__ = ["Bars"]

_PAUSE_S = 60.0
_BAR_WIDTHS = (40, 20, 10)
"""Widths of the bar, characters; the first that fits is taken."""


class Bars(Progress):
    """One line a task: description, bar, count, time and a note; the note is on the next line where it does not fit.

    Rich shows a log file its bars only when all is done, which is hours later for a long run; this class prints a
    line a minute there.

    Args:
        counts: columns between the bar and the note; by default the count and the elapsed time.
        transient: remove the bars at the end.
        refresh_per_second: how often a terminal is redrawn.
        console: where to print.
        pause_s: least time between two lines where there is no terminal, seconds.
    """

    def __init__(
        self,
        *counts: ProgressColumn,
        transient: bool = False,
        refresh_per_second: float = 10.0,
        console: Console = stderr,
        pause_s: float = _PAUSE_S,
    ) -> None:
        self._terminal = console
        self._bar = BarColumn()
        self._counts = counts or (MofNCompleteColumn(), TimeElapsedColumn())
        super().__init__(console=console, transient=transient, refresh_per_second=refresh_per_second)
        self._pause_s = pause_s
        self._said = time.monotonic()

    def add_task(self, description: str, *args: Any, note: str = "", **fields: Any) -> TaskID:
        """Adds a task with a note, which is empty at first."""
        return super().add_task(description, *args, note=note, **fields)

    def update(self, task_id: TaskID, **changes: Any) -> None:
        """Changes a task, and prints a line where no terminal shows its bar."""
        super().update(task_id, **changes)
        self._say()

    def advance(self, task_id: TaskID, advance: float = 1) -> None:
        """Advances a task, and prints a line where no terminal shows its bar."""
        super().advance(task_id, advance)
        self._say()

    def get_renderables(self) -> Iterator[RenderableType]:
        """Yields the bars, and below them the notes that do not fit beside them."""
        yield from self._fitted([task for task in self.tasks if task.visible])

    def _fitted(self, tasks: list[Task]) -> Iterator[RenderableType]:
        room = self._terminal.width
        for width in _BAR_WIDTHS:
            whole = self._table(tasks, width, with_notes=True)
            if _width(self._terminal, whole) <= room:
                yield whole
                return
        widths = (width for width in _BAR_WIDTHS if _width(self._terminal, self._table(tasks, width)) <= room)
        yield self._table(tasks, next(widths, None))
        for task in tasks:
            if task.fields["note"]:
                of = f"{task.description}: " if len(tasks) > 1 else ""
                yield Text(f"  {of}{task.fields['note']}", overflow="fold", no_wrap=False)

    def _table(self, tasks: Iterable[Task], bar_width: int | None, with_notes: bool = False) -> Table:
        """Returns the lines; without a bar when it has no width."""
        self._bar.bar_width = bar_width
        description = TextColumn("{task.description}", table_column=Column(overflow="fold"))
        columns: list[ProgressColumn] = [description, *((self._bar,) if bar_width else ()), *self._counts]
        if with_notes:
            columns.append(TextColumn("{task.fields[note]}"))
        table = Table.grid(
            *(replace(column.get_table_column(), no_wrap=column is not description) for column in columns)
        )
        table.padding = (0, 1)
        for task in tasks:
            table.add_row(*(column(task) for column in columns))
        return table

    def _say(self) -> None:
        now = time.monotonic()
        if self.console.is_terminal or now - self._said < self._pause_s:
            return
        self._said = now
        under_way = [task for task in self.tasks if task.started and not task.finished and task.total]
        if under_way:
            self.console.print(self._table(under_way, None, with_notes=True))


def _width(console: Console, table: Table) -> int:
    """Returns the width that a table would take on an endless line."""
    return Measurement.get(console, console.options.update(max_width=10_000), table).maximum
