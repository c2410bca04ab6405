"""Draws line and column charts as SVG text without styles and scripts; the page's stylesheet sets the colours.

Pure functions.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from html import escape

import numpy as np
from numpy.typing import ArrayLike

WIDTH, WIDE, HEIGHT = 600, 1200, 124
"""Width of a line chart, width of a column chart, and height of both, in units of the view box."""
_LEFT, _TOP, _BOTTOM = 64, 8, 20
_MOST_POINTS = 600


def draw_lines(
    title: str,
    unit: str,
    values: ArrayLike,
    duration_s: float,
    name: str = "",
    span: tuple[float, float] | None = None,
) -> str:
    """Returns a chart of values over time, with a cursor that the page moves.

    Args:
        title: title of the chart.
        unit: unit of the values.
        values: (T,) values at equal distances in time; NaN is omitted.
        duration_s: time of the last value, seconds.
        name: name of the series, for the page's script.
        span: ends of the vertical axis, which contain all values; `None` for the range of the values.
    """
    series = np.asarray(values, float)
    finite = series[np.isfinite(series)]
    low, high = span or ((float(finite.min()), float(finite.max())) if len(finite) else (0.0, 1.0))
    low, high = (low - 0.5, high + 0.5) if high - low < 1e-9 else (low, high)
    steps = np.unique(np.linspace(0, len(series) - 1, min(len(series), _MOST_POINTS)).round().astype(int))
    steps = steps[np.isfinite(series[steps])]
    x = _LEFT + (WIDTH - _LEFT - 4) * steps / max(1, len(series) - 1)
    y = _TOP + (HEIGHT - _TOP - _BOTTOM) * (high - series[steps]) / (high - low)
    points = " ".join(f"{a:.1f},{b:.1f}" for a, b in zip(x, y, strict=True))
    label = f"{title}, {unit}: {low:.3g} to {high:.3g}"
    return (
        f'<svg class="chart" viewBox="0 0 {WIDTH} {HEIGHT}" role="img" aria-label="{escape(label)}" '
        f'data-left="{_LEFT}" data-right="{WIDTH - 4}" data-series="{escape(name)}">'
        f"{_axes(f'{low:.3g}', f'{high:.3g}', '0 s', f'{duration_s:.1f} s')}"
        f'<polyline class="line" points="{points}"/>'
        f'<line class="cursor" x1="{_LEFT}" x2="{_LEFT}" y1="{_TOP}" y2="{HEIGHT - _BOTTOM}"/></svg>'
    )


def draw_columns(title: str, columns: Sequence[Mapping[str, int]], first: str, last: str) -> str:
    """Returns a chart of stacked columns.

    Args:
        title: title of the chart.
        columns: counts by series for each interval, in order of time.
        first: label of the first interval.
        last: label of the last interval.
    """
    most = max((sum(column.values()) for column in columns), default=0) or 1
    wide = (WIDE - _LEFT - 4) / max(1, len(columns))
    room = HEIGHT - _TOP - _BOTTOM
    bars = []
    for place, column in enumerate(columns):
        base = float(HEIGHT - _BOTTOM)
        for series, count in column.items():
            tall = room * count / most
            base -= tall
            bars.append(
                f'<rect class="bar {escape(series)}" x="{_LEFT + place * wide:.1f}" y="{base:.1f}" '
                f'width="{max(1.0, wide - 1):.1f}" height="{tall:.1f}"><title>{count} {escape(series)}</title></rect>'
            )
    return (
        f'<svg class="chart" viewBox="0 0 {WIDE} {HEIGHT}" role="img" aria-label="{escape(title)}, at most {most}">'
        f"{_axes('0', str(most), first=first, last=last, width=WIDE)}{''.join(bars)}</svg>"
    )


def _axes(low: str, high: str, first: str, last: str, width: int = WIDTH) -> str:
    base = HEIGHT - _BOTTOM
    return (
        f'<path class="axis" d="M{_LEFT} {_TOP}V{base}H{width - 4}"/>'
        f'<text x="{_LEFT - 5}" y="{_TOP + 9}" text-anchor="end">{escape(high)}</text>'
        f'<text x="{_LEFT - 5}" y="{base}" text-anchor="end">{escape(low)}</text>'
        f'<text x="{_LEFT}" y="{HEIGHT - 4}">{escape(first)}</text>'
        f'<text x="{width - 4}" y="{HEIGHT - 4}" text-anchor="end">{escape(last)}</text>'
    )
