"""Tables of the page as HTML, everything in them escaped. Pure text."""

from __future__ import annotations

import re
from collections.abc import Sequence
from html import escape

from factory.report.comparison import Comparison
from factory.report.exhibit import Table
from factory.report.exhibits.words import DASH, number, percent

__all__ = ["prose", "write_comparisons", "write_table"]

_TIMES = 2.0
"""Ratio from which on per cent are hard to read."""
_UNIT = re.compile(r"(\d) (?=(?:m|mm|m²|%|pp|Hz)\b|%)")
_ROWS_SHOWN = 8
"""Longer tables are folded."""


def write_comparisons(rows: Sequence[Comparison]) -> str:
    """Returns the table of numbers beside the paper's, each with its reason below; nothing of none."""
    if not rows:
        return ""
    body = "".join(_comparison(row) for row in rows)
    return (
        '<div class="table compare"><table><caption>Beside the paper</caption><thead><tr><th>measure</th><th>here</th>'
        f"<th>paper</th><th>difference</th></tr></thead><tbody>{body}</tbody></table></div>"
    )


def _comparison(row: Comparison) -> str:
    published = _spell(row, row.published)
    if row.published_high is not None:
        published = f"{number(100 * row.published, 0)}–{number(100 * row.published_high, 0)} %"
    cells = (
        f'<th scope="row">{escape(row.what)}</th><td>{_spell(row, row.ours)}</td>'
        f'<td class="paper" title="{escape(row.source)}">{published}</td><td>{_difference(row)}</td>'
    )
    why = f'<tr class="why"><td colspan="4">{prose(row.reason)}</td></tr>' if row.reason else ""
    return f"<tr{' class=off' if row.reason else ''}>{cells}</tr>{why}"


def prose(text: str) -> str:
    """Returns text whose numbers stay on one line with their units."""
    return _UNIT.sub("\\1\u00a0", escape(text))


def _spell(row: Comparison, value: float | None) -> str:
    if row.unit == "share":
        return percent(value, row.digits)
    unit = f" {row.unit}" if row.unit == "m" and value is not None else ""
    return number(value, row.digits) + unit


def _difference(row: Comparison) -> str:
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


def write_table(table: Table) -> str:
    """Returns a table under its title, folded when it is long; columns of numbers stand to the right."""
    numeric = [_is_numeric([row[place] for row in table.rows]) for place in range(len(table.columns))]
    head = "".join(_cell("th", text, right) for text, right in zip(table.columns, numeric, strict=True))
    body = "".join(
        "<tr>" + "".join(_cell("td", text, right) for text, right in zip(row, numeric, strict=True)) + "</tr>"
        for row in table.rows
    )
    whole = f'<div class="table"><table><thead><tr>{head}</tr></thead><tbody>{body}</tbody></table></div>'
    is_open = " open" if len(table.rows) <= _ROWS_SHOWN else ""
    return f"<details{is_open}><summary>{escape(table.title)}</summary>{whole}</details>"


def _cell(tag: str, text: str, right: bool) -> str:
    return f"<{tag}{' class=n' if right else ''}>{escape(text)}</{tag}>"


def _is_numeric(cells: Sequence[str]) -> bool:
    return all(cell[:1].isdigit() or cell[:1] in {DASH, "−", "<", "("} for cell in cells)
