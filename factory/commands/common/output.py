"""Prints results as JSON, tables or text: results on stdout, notes on stderr. Computes nothing."""

from __future__ import annotations

import json
import sys
from collections.abc import Callable, Iterable, Iterator, Sequence
from typing import Any, TypeVar

import click
from pydantic import BaseModel
from rich.cells import cell_len
from rich.console import Console, ConsoleOptions, JustifyMethod
from rich.table import Table

R = TypeVar("R")
_PIPE_COLUMNS = 200
"""Width of tables without a terminal, characters."""
_GAP = 2
"""Spaces between columns."""
_MOST_KEYS = 3
"""Maximum number of text columns that identify a row."""

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
    title: str, columns: Sequence[str], rows: Iterable[Sequence[object]], console: Console = stdout
) -> None:
    """Prints a table; see `FittedTable`."""
    console.print(FittedTable(title, columns, rows))


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
