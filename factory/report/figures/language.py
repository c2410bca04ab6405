"""Figure of the language statistics: targets found without language, ambiguity, target in view (none in the paper)."""

from __future__ import annotations

from collections.abc import Mapping

from factory.html.palette import colour
from factory.report.data import ReportInput
from factory.report.drawing.canvas import Axes, draw_panel
from factory.report.drawing.figure import Figure, Table
from factory.report.drawing.text import count, interval, name, number
from factory.stats.language import summarise_language
from factory.stats.statistics import LanguageRow, LanguageStatistics, Share

_MEASURES = {
    "nearest": ("target is nearest", "won"),
    "central": ("target is most central", "won"),
    "central_of_category": ("target is most central\nof its category", "won"),
    "nearest_of_category": ("target is nearest\nof its category", "won"),
    "largest_of_category": ("target is largest\nof its category", "won"),
    "several_in_scene": ("fits several objects\nin the scene", "timeout"),
    "several_in_view": ("fits several objects\nin view", "timeout"),
    "contradictory": ("contradictory", "collision"),
    "not_in_front": ("“in front of you”,\nbut not in front", "collision"),
}
"""Field of a row -> label and colour."""
_TABLES = {
    "Target in the first frame by scene": {
        "nearest": "nearest",
        "most central": "central",
        "of its category": "central_of_category",
        "nearest of its category": "nearest_of_category",
        "largest": "largest_of_category",
    },
    "Unclear instructions by scene": {
        "several in scene": "several_in_scene",
        "several in view": "several_in_view",
        "contradictory": "contradictory",
        "not in front": "not_in_front",
    },
}
"""Title of a table -> heading and field of its columns."""


def draw(material: ReportInput) -> Figure:
    """Returns the shares of all episodes with their intervals, and the tables by scene and by category."""
    title, source = "Instructions and objects in view", "no figure in the paper"
    views, everything = material.drives.views, len(material.episodes)
    if not views:
        return Figure("language", title, source, "No episodes to show.")
    summary = summarise_language(
        material.meta.run, material.meta.run, scenes=material.scenes, episodes=everything, views=views
    )
    caption = (
        f"Shares of {count(summary.read, 'episode')} with 95 % Wilson intervals; "
        f"{count(summary.instructions, 'distinct instruction')}. "
        "Blue, in the first frame: the target is the object nearest to the camera, or the object with the "
        "smallest bearing, or the object of its category with the smallest bearing, the smallest distance or the "
        "largest mask, so it can be found without language or without spatial reasoning. "
        "Yellow: category and colour of the instruction fit several objects. "
        "Red: the target is not in view in the first frame but another object of its category is (contradictory), or "
        "the instruction has “in front of you” and the target is not in view or more than 30 degrees from the heading."
    )
    panel = draw_panel(
        "language",
        "Shares of episodes by measure",
        lambda axes: _paint(axes, summary.rows[-1]),
        0.9 + 0.4 * len(_MEASURES),
    )
    tables = (
        *(_scene_table(summary, *table) for table in _TABLES.items()),
        _wording_table(summary),
        _arrival_table(summary),
    )
    return Figure("language", title, source=source, caption=caption, panels=(panel,), tables=tables)


def _paint(axes: Axes, row: LanguageRow) -> None:
    for place, (field, (_, fill)) in enumerate(_MEASURES.items()):
        share: Share = getattr(row, field)
        if share.share is None or share.low is None or share.high is None:
            continue
        ends = [100 * share.low, 100 * share.high]
        axes.plot(ends, [place, place], color=colour(fill), linewidth=2, solid_capstyle="butt")
        axes.plot(100 * share.share, place, "o", markersize=6.5, color=colour(fill))
        beyond, side = (ends[1] + 1.5, "left") if ends[1] < 88 else (ends[0] - 1.5, "right")
        axes.text(beyond, place, f"{100 * share.share:.0f} %", va="center", ha=side, fontsize=8.5)
    axes.set_yticks(range(len(_MEASURES)), [label for label, _ in _MEASURES.values()])
    axes.set_ylim(len(_MEASURES) - 0.5, -0.5)
    axes.set_xlim(-2, 102)
    axes.grid(visible=False, axis="y")
    axes.set_xlabel("share of the episodes, %")


def _scene_table(statistics: LanguageStatistics, title: str, columns: Mapping[str, str]) -> Table:
    rows = tuple(
        (name(row.group), *(interval(getattr(row, key)) for key in columns.values())) for row in statistics.rows
    )
    return Table(("scene", *columns), rows, f"{title}; 95 % intervals")


def _wording_table(statistics: LanguageStatistics) -> Table:
    rows = tuple(
        (
            row.language,
            *(str(count) for count in (row.n, row.distinct, row.vocabulary)),
            *(number(value, digits) for value, digits in ((row.words_mean, 1), (row.self_bleu, 2))),
        )
        for row in statistics.wording
    )
    others, chance, wrong = (
        number(statistics.others_in_scene, 1),
        number(statistics.rows[-1].chance, 2),
        statistics.false_premises,
    )
    return Table(
        ("language", "N", "distinct", "vocabulary", "words, mean", "self-BLEU"),
        rows,
        f"Wording; {interval(statistics.unique)} of the instructions fit one object of the scene, {wrong} fit "
        f"none; {others} other objects of the category in the scene; "
        f"chance that a random object of the category in view is the target: {chance}",
    )


def _arrival_table(statistics: LanguageStatistics) -> Table:
    rows = tuple((name(row.group), str(row.in_view.of), interval(row.in_view)) for row in statistics.arrivals)
    return Table(("category", "N", "in view in the last frame"), rows, "Target in view on arrival; 95 % intervals")
