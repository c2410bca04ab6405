"""Progress bars on stderr that fit the terminal. In a log file, one line per minute is printed instead.

This module is the only user of rich's `Progress`.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
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

from factory.commands.common.output import stderr

_PAUSE_S = 60.0
_BAR_WIDTHS = (40, 20, 10)
"""Widths of the bar, characters; the first that fits is used."""


class Bars(Progress):
    """One line per task: description, bar, count, time and a note. A note that does not fit is on the next line.

    Without a terminal, rich prints its bars only at the end, hours later for a long run. This class prints one line
    per minute instead.

    Args:
        counts: columns between the bar and the note; by default the count and the elapsed time.
        transient: remove the bars at the end.
        refresh_per_second: refresh rate on a terminal.
        console: output console.
        pause_s: minimum time between two lines without a terminal, seconds.
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
        self._last_line_at = time.monotonic()

    def add_task(self, description: str, *args: Any, note: str = "", **fields: Any) -> TaskID:
        """Adds a task with a note; the default is an empty note."""
        return super().add_task(description, *args, note=note, **fields)

    def update(self, task_id: TaskID, **changes: Any) -> None:
        """Updates a task; without a terminal, prints a line."""
        super().update(task_id, **changes)
        self._print_line()

    def advance(self, task_id: TaskID, advance: float = 1) -> None:
        """Advances a task; without a terminal, prints a line."""
        super().advance(task_id, advance)
        self._print_line()

    def get_renderables(self) -> Iterator[RenderableType]:
        """Yields the bars, then the notes that do not fit on the lines of the bars."""
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
        """Returns the lines as a table; without bars when `bar_width` is `None`."""
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

    def _print_line(self) -> None:
        now = time.monotonic()
        if self.console.is_terminal or now - self._last_line_at < self._pause_s:
            return
        self._last_line_at = now
        under_way = [task for task in self.tasks if task.started and not task.finished and task.total]
        if under_way:
            self.console.print(self._table(under_way, None, with_notes=True))


@contextmanager
def one_bar(title: str, *counts: ProgressColumn) -> Iterator[Callable[[int, int], None]]:
    """Shows the bar of one task, which is removed at the end; yields the function that sets done and total."""
    with Bars(*counts, transient=True) as bar:
        task = bar.add_task(title, total=None)
        yield lambda done, total: bar.update(task, completed=done, total=total)


def _width(console: Console, table: Table) -> int:
    """Returns the width of a table on a console of unlimited width."""
    return Measurement.get(console, console.options.update(max_width=10_000), table).maximum
