"""Prints on the terminal: results as JSON, tables or text on stdout, notes and progress bars on stderr.

Tables and bars fit the width of the terminal. In a log file, a progress bar is one line per minute. Computes nothing.
This module is the only user of rich's `Progress`.
"""

from __future__ import annotations

import json
import sys
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from datetime import UTC, datetime
from typing import Any, TypeVar

import click
from pydantic import BaseModel
from rich.cells import cell_len
from rich.console import Console, ConsoleOptions, JustifyMethod, RenderableType
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

R = TypeVar("R")
_PIPE_COLUMNS = 200
"""Width of tables without a terminal, characters."""
_GAP = 2
"""Spaces between columns."""
_MOST_KEYS = 3
"""Maximum number of text columns that identify a row."""
_PAUSE_S = 60.0
_BAR_WIDTHS = (40, 20, 10)
"""Widths of the bar, characters; the first that fits is used."""

stdout = Console(highlight=False, soft_wrap=True, width=None if sys.stdout.isatty() else _PIPE_COLUMNS)
stderr = Console(stderr=True, highlight=False, soft_wrap=True, width=None if sys.stderr.isatty() else _PIPE_COLUMNS)


def print_json(data: Any) -> None:
    """Prints data as indented JSON."""
    click.echo(json.dumps(data, indent=2, ensure_ascii=False))


def print_result(result: R, as_json: bool, show: Callable[[R], None]) -> None:
    """Prints a result: a model or plain data as JSON, otherwise as text with `show`."""
    if as_json:
        print_json(result.model_dump(mode="json") if isinstance(result, BaseModel) else result)
    else:
        show(result)


def print_text(text: str, console: Console = stdout) -> None:
    """Prints text; on a terminal, lines are wrapped between words."""
    if console.is_terminal:
        console.print(text, soft_wrap=False, markup=False)
    else:
        click.echo(text, file=console.file)


def print_table(
    title: str,
    columns: Sequence[str],
    rows: Iterable[Sequence[object]],
    console: Console = stdout,
    widest: int = _PIPE_COLUMNS,
) -> None:
    """Prints a table; see `FittedTable`.

    Args:
        title: title.
        columns: column names.
        rows: rows.
        console: output console.
        widest: largest width without a terminal, characters.
    """
    console.print(FittedTable(title, columns, rows), width=None if console.is_terminal else widest)


class FittedTable:
    """A table that fits the terminal; columns of numbers are aligned right.

    A table that is too wide is printed with narrower gaps or, if that is not enough, in pieces. Each piece repeats
    the leading text columns, which identify the rows.

    Args:
        title: printed above the first piece.
        columns: column names.
        rows: rows with one cell per column; `None` is printed as a dash.
        min_first: minimum width of the first column, characters.
    """

    def __init__(
        self, title: str, columns: Sequence[str], rows: Iterable[Sequence[object]], min_first: int = 0
    ) -> None:
        body = [list(row) for row in rows]
        self._title = title
        self._columns = [column if k else column.ljust(min_first) for k, column in enumerate(columns)]
        self._numeric = [
            bool(body) and all(isinstance(row[k], int | float) for row in body) for k in range(len(columns))
        ]
        self._cells = [[_cell(value) for value in row] for row in body]

    def __rich_console__(self, console: Console, options: ConsoleOptions) -> Iterator[Table]:
        """Yields the table, or its pieces, at the width of the console."""
        widths = [max(map(cell_len, (name, *(row[k] for row in self._cells)))) for k, name in enumerate(self._columns)]
        room = options.max_width
        gap = next((gap for gap in (_GAP, 1) if sum(widths) + gap * (len(widths) - 1) <= room), _GAP)
        for number, piece in enumerate(_pieces(widths, self._cells, room, gap)):
            table = Table(
                title=None if number else self._title or None,
                title_justify="left",
                header_style="bold",
                box=None,
                pad_edge=False,
                padding=(0, gap, 0, 0),
            )
            for k in piece:
                justify: JustifyMethod = "right" if self._numeric[k] else "left"
                table.add_column(self._columns[k], justify=justify, overflow="fold")
            for row in self._cells:
                table.add_row(*(row[k] for k in piece))
            yield table


def _pieces(widths: Sequence[int], cells: Sequence[Sequence[str]], room: int, gap: int) -> list[list[int]]:
    """Returns the columns of each piece of at most `room` characters. Each piece has the columns that identify rows."""
    names = [all(map(str.isidentifier, (row[k][:1] for row in cells))) for k in range(min(_MOST_KEYS, len(widths)))]
    keys = max(1, (*names, False).index(False))
    while keys > 1 and sum(widths[:keys]) + gap * keys > room / 2:
        keys -= 1
    pieces = [list(range(keys))]
    for k in range(keys, len(widths)):
        if len(pieces[-1]) > keys and sum(widths[j] + gap for j in (*pieces[-1], k)) - gap > room:
            pieces.append(list(range(keys)))
        pieces[-1].append(k)
    return pieces


def print_building(name: str) -> None:
    """Prints on stderr that a scene is built."""
    click.echo(f"building {name}; this is done once and takes some seconds, or minutes for a large scene", err=True)


def _cell(value: object) -> str:
    if value is None:
        return "-"
    return f"{value:.2f}" if isinstance(value, float) else str(value)


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

    def _table(self, tasks: Iterable[Task], bar_width: int | None, with_notes: bool = False, stamp: str = "") -> Table:
        """Returns the lines as a table; without bars when `bar_width` is `None`, and after a time if one is given."""
        self._bar.bar_width = bar_width
        description = TextColumn("{task.description}", table_column=Column(overflow="fold"))
        columns: list[ProgressColumn] = [description, *((self._bar,) if bar_width else ()), *self._counts]
        if with_notes:
            columns.append(TextColumn("{task.fields[note]}"))
        table = Table.grid(
            *((Column(no_wrap=True),) if stamp else ()),
            *(replace(column.get_table_column(), no_wrap=column is not description) for column in columns),
        )
        table.padding = (0, 1)
        for task in tasks:
            table.add_row(*((stamp,) if stamp else ()), *(column(task) for column in columns))
        return table

    def _print_line(self) -> None:
        now = time.monotonic()
        if self.console.is_terminal or now - self._last_line_at < self._pause_s:
            return
        self._last_line_at = now
        under_way = [task for task in self.tasks if task.started and not task.finished and task.total]
        if under_way:
            stamp = f"{datetime.now(UTC):%Y-%m-%d %H:%M:%S} UTC"
            self.console.print(self._table(under_way, None, with_notes=True, stamp=stamp))


@contextmanager
def one_bar(title: str, *counts: ProgressColumn) -> Iterator[Callable[[int, int], None]]:
    """Shows the bar of one task, which is removed at the end; yields the function that sets done and total."""
    with Bars(*counts, transient=True) as bar:
        task = bar.add_task(title, total=None)
        yield lambda done, total: bar.update(task, completed=done, total=total)


def _width(console: Console, table: Table) -> int:
    """Returns the width of a table on a console of unlimited width."""
    return Measurement.get(console, console.options.update(max_width=10_000), table).maximum
