"""Figure of the 7 x 7 action grid (paper Fig. 1) with the share of steps per grid point."""

from __future__ import annotations

import numpy as np

from factory.html.palette import colour
from factory.report.data import ReportInput
from factory.report.drawing.canvas import Axes, draw_panel
from factory.report.drawing.figure import Figure, Table
from factory.report.drawing.text import count, number, percent
from schemas.tokens import GRID_POINTS, V_GRID_MPS, W_GRID_RPS

_PALEST, _FULLEST = 0.10, 0.80
_STRAIGHT = GRID_POINTS // 2
_MOST = 8
"""Maximum number of rows of the table."""


def draw(material: ReportInput) -> Figure:
    """Returns the heat map and the most frequent tokens."""
    drives = material.drives
    title, source = "Action space and its use", "Fig. 1; the paper shows the grid only"
    if not drives.steps:
        return Figure("action_space", title, source, "No steps to show: no episode could be read.")
    used = int((drives.tokens > 0).sum())
    read = f"{len(drives.tracks)} of {count(len(material.episodes), 'episode')}"
    caption = (
        f"Each square is one of the {GRID_POINTS}×{GRID_POINTS} = {GRID_POINTS**2} tokens of speed v and yaw rate ω; "
        f"its shade (logarithmic) and number show the share of {drives.steps:,} recorded steps of {read} whose action "
        f"is nearest to the token. {used} of {GRID_POINTS**2} tokens occur. Positive ω turns left."
    )
    alt = f"Grid of {GRID_POINTS} speeds by {GRID_POINTS} yaw rates, {used} squares shaded by use"
    panel = draw_panel("action_space", alt, lambda axes: _paint(axes, drives.tokens), height_in=3.9)
    return Figure(
        "action_space", title, source=source, caption=caption, panels=(panel,), tables=(_table(drives.tokens),)
    )


def _paint(axes: Axes, tokens: np.ndarray[tuple[int, ...], np.dtype[np.int64]]) -> None:
    total, most = tokens.sum(), np.log1p(tokens.max())
    for v in range(GRID_POINTS):
        for w in range(GRID_POINTS):
            tone = _PALEST + (_FULLEST - _PALEST) * np.log1p(tokens[v, w]) / most
            shown = bool(tokens[v, w])
            fill = colour("scene1") if shown else colour("floor")
            axes.bar(w, 0.92, 0.92, v - 0.46, color=fill, alpha=float(tone) if shown else 1.0)
            text = _percentage(float(tokens[v, w] / total)) if shown else "·"
            axes.text(w, v, text, ha="center", va="center", fontsize=7.5, color=colour("ink" if shown else "muted"))
    axes.text(_STRAIGHT, -0.62, "stop", ha="center", va="top", fontsize=8, weight="bold")
    axes.text(_STRAIGHT, GRID_POINTS - 0.46, "full speed ahead", ha="center", va="bottom", fontsize=8, weight="bold")
    axes.set_xticks(range(GRID_POINTS), [f"{w:+.1f}".replace("-", "−") for w in W_GRID_RPS])
    axes.set_yticks(range(GRID_POINTS), [f"{v:.2f}" for v in V_GRID_MPS])
    axes.set_xlim(GRID_POINTS - 0.5, -0.5)
    axes.set_ylim(-1.0, GRID_POINTS - 0.2)
    axes.grid(visible=False)
    axes.tick_params(length=0)
    axes.spines[["left", "bottom"]].set_visible(False)
    axes.set_xlabel("yaw rate ω, rad/s (left turns on the left)")
    axes.set_ylabel("speed v, m/s")


def _percentage(share: float) -> str:
    if share < 0.0005:
        return "<0.1"
    return f"{100 * share:.1f}"


def _table(tokens: np.ndarray[tuple[int, ...], np.dtype[np.int64]]) -> Table:
    order = np.argsort(-tokens, axis=None, kind="stable")[:_MOST]
    rows = []
    for v, w in zip(*np.unravel_index(order, tokens.shape), strict=True):
        if tokens[v, w]:
            share = percent(float(tokens[v, w] / tokens.sum()))
            rows.append(
                (f"({v}, {w})", number(float(V_GRID_MPS[v])), number(float(W_GRID_RPS[w])), f"{tokens[v, w]:,}", share)
            )
    return Table(("token", "v, m/s", "ω, rad/s", "steps", "share"), tuple(rows), "Most frequent tokens")
