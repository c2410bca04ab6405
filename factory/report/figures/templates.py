"""Figure of instruction templates (paper Fig. 12)."""

from __future__ import annotations

from factory.html.palette import colour
from factory.report.data import ReportInput
from factory.report.drawing.canvas import Axes, Panel, count_whole, draw_panel, write_legend
from factory.report.drawing.figure import Figure, Table
from factory.report.drawing.text import count, percent
from factory.stats.statistics import CountRow
from schemas.instruction.templates import OOD_TEMPLATES, TEMPLATES, TRAIN_TEMPLATES, needs_colour


def draw(material: ReportInput) -> Figure:
    """Returns one panel for the training templates and one for the paraphrases."""
    title, source = "Instruction templates", "Fig. 12, Table III"
    if not material.episodes:
        return Figure("templates", title, source, "No episodes to show.")
    rows = {row.group: row for row in material.statistics.templates}
    coloured = sum(row.n for row in rows.values() if row.group in TEMPLATES and needs_colour(row.group))
    beside = "; none in the paper" if material.statistics.beside_paper else ""
    caption = (
        f"Instruction templates of {count(len(material.episodes), 'episode')}. T1 to T18 are for training "
        f"and its tests, O1 to O12 for test_paraphrase_ood only. Yellow bars are templates with a colour "
        f"({count(coloured, 'episode')}){beside}."
    )
    pools = (
        ("templates_train", "training templates", "T", list(TRAIN_TEMPLATES)),
        ("templates_paraphrase", "paraphrases", "O", list(OOD_TEMPLATES)),
    )
    panels = tuple(_panel(rows, *pool) for pool in pools)
    return Figure("templates", title, source=source, caption=caption, panels=panels, tables=(_table(rows),))


def _panel(rows: dict[str, CountRow], name: str, words: str, letter: str, pool: list[str]) -> Panel:
    shown = [rows[key] for key in pool]
    return draw_panel(name, f"Episodes by {words}", lambda axes: _paint(axes, shown, letter, words), 2.5)


def _paint(axes: Axes, rows: list[CountRow], letter: str, words: str) -> None:
    fills = [colour("timeout") if needs_colour(row.group) else colour("won") for row in rows]
    axes.bar(range(1, len(rows) + 1), [row.n for row in rows], 0.7, color=fills)
    plain = [row.n for row in rows if not needs_colour(row.group)]
    if plain:
        mean = sum(plain) / len(plain)
        label = f"mean of those without colour, {mean:.1f}"
        axes.axhline(mean, color=colour("muted"), linewidth=1, linestyle=(0, (4, 2)), label=label)
    for place, row in enumerate(rows, 1):
        axes.text(place, row.n, str(row.n), ha="center", va="bottom", fontsize=8)
    axes.set_xticks(range(1, len(rows) + 1), [f"{letter}{place}" for place in range(1, len(rows) + 1)], fontsize=7.5)
    axes.grid(visible=False, axis="x")
    axes.tick_params(axis="x", length=0)
    axes.set_ylabel("episodes")
    axes.margins(y=0.14)
    count_whole(axes.yaxis)
    axes.set_title(words, pad=20)
    write_legend(axes)


def _table(rows: dict[str, CountRow]) -> Table:
    texts = {key: TEMPLATES.get(key, "not a template of the paper") for key in rows}
    body = tuple((key, texts[key], str(row.n), percent(row.share)) for key, row in rows.items())
    return Table(("id", "template", "N", "share"), body, "All templates")
