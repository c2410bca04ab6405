"""Formats the tables of the page: comparisons with the paper, and tables of figures.

Pure functions. Does not escape text.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from factory.report.comparison.paper_comparison import PaperComparison
from factory.report.drawing.figure import Table
from factory.report.drawing.text import DASH, number, percent
from factory.stats.statistics import Interval

_TIMES = 2.0
"""Threshold of `ours` divided by `published`: from it, the difference is shown as a factor instead of per cent."""
_ROWS_SHOWN = 8
"""A table with at most this number of rows is initially open."""
Cells = Sequence[tuple[str, bool]]
"""Text of each cell, and whether its column is numeric and right-aligned."""


@dataclass(frozen=True)
class ComparisonCells:
    """Text of the cells of one comparison."""

    what: str
    """Name of the compared number."""
    ours: str
    """Number of the dataset."""
    interval: str
    """95 % interval of `ours`, or empty."""
    published: str
    target: str
    """Range of numbers that agree with the paper; empty if `published` itself is a range."""
    source: str
    difference: str
    verdict: str
    reason: str


@dataclass(frozen=True)
class TableCells:
    """Text of the cells of one table of a figure."""

    title: str
    head: Cells
    rows: Sequence[Cells]

    @property
    def is_open(self) -> bool:
        """Whether the table is initially open."""
        return len(self.rows) <= _ROWS_SHOWN


def format_comparison(row: PaperComparison) -> ComparisonCells:
    published = _format_value(row, row.published)
    if row.published_high is not None:
        published = f"{number(100 * row.published, 0)}–{number(100 * row.published_high, 0)} %"
    return ComparisonCells(
        row.what,
        _format_value(row, row.ours),
        interval=_format_ends(row, row.interval),
        published=published,
        target="" if row.published_high is not None else _format_ends(row, row.target),
        source=row.source,
        difference=_difference(row),
        verdict=row.verdict or "",
        reason=row.reason,
    )


def format_table(table: Table) -> TableCells:
    """Formats a table and marks numeric columns."""
    right = [_is_numeric([row[place] for row in table.rows]) for place in range(len(table.columns))]
    head, *rows = (list(zip(row, right, strict=True)) for row in (table.columns, *table.rows))
    return TableCells(table.title, head, rows)


def _format_value(row: PaperComparison, value: float | None) -> str:
    if row.unit == "share":
        return percent(value, row.digits)
    unit = f" {row.unit}" if row.unit == "m" and value is not None else ""
    return number(value, row.digits) + unit


def _format_ends(row: PaperComparison, ends: Interval | None) -> str:
    if ends is None:
        return ""
    factor, digits = (100, 0) if row.unit == "share" else (1, max(row.digits, 3 if row.unit == "" else 0))
    return "–".join(number(factor * end, digits) for end in ends)


def _difference(row: PaperComparison) -> str:
    difference = row.difference
    if difference is None:
        return DASH
    if row.unit == "share":
        return "inside" if row.published_high is not None and difference == 0 else f"{_signed(100 * difference, 1)} pp"
    if row.unit in {"m", "steps"} and row.ratio is not None:
        ratio = f"{_signed(100 * (row.ratio - 1), 1)} %" if row.ratio < _TIMES else f"{number(row.ratio, 1)} times"
        return f"{_signed(difference, row.digits)} ({ratio})"
    return _signed(difference, row.digits)


def _signed(value: float, digits: int) -> str:
    text = f"{value:+.{digits}f}"
    return ("±" + text[1:] if float(text) == 0 else text).replace("-", "−")


def _is_numeric(cells: Sequence[str]) -> bool:
    return all(cell[:1].isdigit() or cell[:1] in {DASH, "−", "<", "("} for cell in cells)
