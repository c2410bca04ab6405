"""How results are printed: JSON or tables on stdout, bars and remarks on stderr. Prints, never computes."""

from __future__ import annotations

import json
import sys
from collections.abc import Iterable, Sequence
from typing import Any

import click
from rich.cells import cell_len
from rich.console import Console
from rich.table import Table

__all__ = ["json_option", "print_json", "print_table", "say_duration", "stderr", "stdout"]

_PIPE_COLUMNS = 200
"""Width of tables where no terminal sets one."""
_GAP = 2
"""Spaces between columns."""
_MOST_KEYS = 3
"""Columns of text that tell the rows of a table apart."""

stdout = Console(highlight=False, soft_wrap=True, width=None if sys.stdout.isatty() else _PIPE_COLUMNS)
stderr = Console(stderr=True, highlight=False, soft_wrap=True, width=None if sys.stderr.isatty() else _PIPE_COLUMNS)

json_option = click.option("--json", "as_json", is_flag=True, help="Print the result as JSON.")


def print_json(data: Any) -> None:
    """Prints plain data as indented JSON."""
    click.echo(json.dumps(data, indent=2, ensure_ascii=False))


def print_table(
    title: str, columns: Sequence[str], rows: Iterable[Sequence[object]], console: Console = stdout
) -> None:
    """Prints a table; columns whose cells are numbers stand to the right.

    One that is wider than the terminal is printed in pieces, each with the columns of text that a row begins with.
    """
    body = [list(row) for row in rows]
    numeric = [bool(body) and all(isinstance(row[k], int | float) for row in body) for k in range(len(columns))]
    cells = [[_cell(value) for value in row] for row in body]
    for number, piece in enumerate(_pieces(columns, cells, console.width)):
        table = Table(
            title=None if number else title, title_justify="left", header_style="bold", box=None, pad_edge=False
        )
        for k in piece:
            table.add_column(columns[k], justify="right" if numeric[k] else "left", overflow="fold")
        for row in cells:
            table.add_row(*(row[k] for k in piece))
        console.print(table)


def _pieces(columns: Sequence[str], cells: Sequence[Sequence[str]], room: int) -> list[list[int]]:
    """Returns the columns of every piece that fits into `room` characters; those that name a row are in each."""
    widths = [max(map(cell_len, (name, *(row[k] for row in cells)))) for k, name in enumerate(columns)]
    names = [all(map(str.isidentifier, (row[k][:1] for row in cells))) for k in range(min(_MOST_KEYS, len(columns)))]
    keys = max(1, (*names, False).index(False))
    while keys > 1 and sum(widths[:keys]) + _GAP * keys > room / 2:
        keys -= 1
    pieces = [list(range(keys))]
    for k in range(keys, len(columns)):
        if len(pieces[-1]) > keys and sum(widths[j] + _GAP for j in (*pieces[-1], k)) - _GAP > room:
            pieces.append(list(range(keys)))
        pieces[-1].append(k)
    return pieces


def say_duration(seconds: float | None) -> str:
    """Returns seconds as `1 h 05 min`, `4 min 10 s` or `12 s`; a dash when unknown."""
    if seconds is None:
        return "-"
    minutes, rest = divmod(round(seconds), 60)
    hours, minutes = divmod(minutes, 60)
    if hours:
        return f"{hours} h {minutes:02d} min"
    return f"{minutes} min {rest:02d} s" if minutes else f"{rest} s"


def _cell(value: object) -> str:
    if value is None:
        return "-"
    return f"{value:.2f}" if isinstance(value, float) else str(value)
