"""Prints the statistics of a dataset: the tables of the paper, or those of instructions and objects in view.

Computes nothing.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import click

from factory.html.measures import PLACES, definitions_of
from factory.stats import paper
from factory.stats.statistics import (
    AttemptRow,
    CountRow,
    ErrorRow,
    FarRow,
    Fit,
    LanguageRow,
    LanguageStatistics,
    RolloutRow,
    Share,
    Statistics,
    WordingRow,
)
from factory.support.terminal import print_table, print_text

_ROLLOUT = ("N", "share", "NE", "TL", "TL med", "steps", "steps med")
_DASH = "-"
_MOST_PATTERNS = 12
"""Number of sentence patterns that are listed; `--json` has all."""


def print_statistics(statistics: Statistics) -> None:
    """Prints all tables."""
    count = f"{statistics.episodes} of {statistics.planned} episodes"
    print_text(f"{statistics.dataset}: {count}, run {statistics.run}, {statistics.expert} expert")
    beside = statistics.beside_paper
    published = "; columns `paper`: published values" if beside else ""
    print_text(
        f"NE to the {PLACES[statistics.success]} and TL in metres; means unless noted{published}; 95 % intervals"
    )
    for name, definition in definitions_of(("NE", "TL")).items():
        print_text(f"{name}: {definition}")
    for name, rows in (
        ("scene", statistics.scenes),
        ("split", statistics.splits),
        ("tier", statistics.tiers),
        ("scene / tier", statistics.scene_tiers),
    ):
        _print_rollouts(name, rows)
    _print_counts("category", statistics.categories, beside)
    published = f" (paper {_percent(paper.THREE_LARGEST_SHARE)})" if beside else ""
    print_text(f"three largest categories: {_percent(statistics.three_largest_share)} of the episodes{published}")
    _print_counts("template", statistics.templates, beside)
    _print_attempts(statistics.attempts, beside)
    _print_cells(statistics)
    radius_m = statistics.success_radius_m
    other = next(measure for measure in PLACES if measure is not statistics.success)
    _print_errors(f"NE to the {PLACES[statistics.success]}", statistics.navigation_error, radius_m, beside)
    if statistics.other_error:
        _print_errors(f"NE to the {PLACES[other]}", statistics.other_error, radius_m, beside=False)
    _print_fits((*statistics.correlation, paper.FIT) if beside else statistics.correlation)
    _print_overlap(statistics)
    _print_far(statistics.far)


def print_language(statistics: LanguageStatistics) -> None:
    """Prints the language statistics, at most 80 columns wide for the built-in scenes."""
    print_text(f"{statistics.dataset}: {statistics.read} of {statistics.episodes} episodes read, run {statistics.run}")
    print_text(f"distinct instructions: {statistics.instructions}; shares of the episodes with 95 % intervals")
    print_text(
        f"the instruction fits exactly one object of the scene: {_interval(statistics.unique)}\n"
        f"false premises: {statistics.false_premises}; other objects of the category: "
        f"{_number(statistics.others_in_scene, 1)} in the scene"
    )
    _print_wording(statistics.wording)
    _print_features(statistics)
    print_text(
        "\nShare of episodes whose target is, at the start, the nearest object in view,\n"
        "the most central object, or the most central object of its category"
    )
    _print_shares(statistics.rows, {"nearest": "nearest", "central": "central", "of category": "central_of_category"})
    print_text(
        "\nShare of episodes whose target is the nearest object of its category in view at\n"
        "the start, or has the largest mask of these objects. If targets are drawn at the\n"
        "start, only objects that could have been drawn count. chance: expected share if\n"
        "the target were a random one of these objects; others: mean number of these\n"
        "objects, without the target"
    )
    body = [
        (
            *(row.group, _interval(row.nearest_of_category), _interval(row.largest_of_category)),
            *(_percent(row.chance), _number(row.others_in_view, 1)),
        )
        for row in statistics.rows
    ]
    _table(("scene", "nearest", "largest", "chance", "others"), body)
    print_text(
        "\nShare of episodes whose instruction fits several objects of the scene, or\n"
        "several objects in view at the start; contradictory: another object of the\n"
        "category is in view, but not the target"
    )
    columns = {"in scene": "several_in_scene", "in view": "several_in_view", "contradictory": "contradictory"}
    _print_shares(statistics.rows, columns)
    away = statistics.rows[-1].not_in_front
    print_text(
        f"\nInstructions with 'in front of you': {away.of}; the target is not in view, or more than\n"
        f"30 degrees from the heading, in {away.count}: {_interval(away)}"
    )
    print_text("\nShare of episodes whose target is in view in the last frame")
    arrivals = [(row.group, str(row.in_view.of), _interval(row.in_view)) for row in statistics.arrivals]
    _table(("category", "N", "in view"), arrivals)


def _print_wording(rows: Sequence[WordingRow]) -> None:
    body = [
        (
            row.language,
            *(str(count) for count in (row.n, row.distinct, row.vocabulary)),
            f"{_number(row.words_mean, 1)} ({row.words_least}-{row.words_most})",
            _number(row.self_bleu, 2),
        )
        for row in rows
    ]
    _table(("language", "N", "distinct", "vocabulary", "words (range)", "self-BLEU"), body)


def _print_features(statistics: LanguageStatistics) -> None:
    if statistics.features:
        print_text(
            "\nFeatures of the verified instructions, which may have several; asked: share of\n"
            "the feature's weight in the plan"
        )
        body = [
            (
                row.feature,
                *(_percent(row.asked), _percent(row.largest)),
                *(str(row.realised.count), _interval(row.realised)),
            )
            for row in statistics.features
        ]
        _table(("feature", "asked", "at most", "N", "realised"), body)
    shown, rest = statistics.patterns[:_MOST_PATTERNS], statistics.patterns[_MOST_PATTERNS:]
    more = f"; {len(rest)} others have {sum(row.realised.count for row in rest)} together" if rest else ""
    print_text(f"\nSentence patterns or templates, most frequent first{more}")
    _table(
        ("pattern", "N", "realised"), [(row.pattern, str(row.realised.count), _interval(row.realised)) for row in shown]
    )


def _print_shares(rows: Sequence[LanguageRow], columns: Mapping[str, str]) -> None:
    body = [(row.group, str(row.n), *(_interval(getattr(row, field)) for field in columns.values())) for row in rows]
    _table(("scene", "N", *columns), body)


def _print_rollouts(name: str, rows: Sequence[RolloutRow]) -> None:
    has_paper = any(row.paper for row in rows)
    body = [(row.group, *_rollout_cells(row), *(_published_cells(row) if has_paper else ())) for row in rows]
    columns = (name, *_ROLLOUT, *(f"paper {column}" for column in _ROLLOUT if has_paper))
    _table(columns, body)


def _rollout_cells(row: RolloutRow) -> tuple[str, ...]:
    means = (_number(row.ne_mean_m, 3), _number(row.tl_mean_m), _number(row.tl_median_m))
    return (str(row.n), _percent(row.share), *means, _number(row.steps_mean, 1), _number(row.steps_median, 1))


def _published_cells(row: RolloutRow) -> tuple[str, ...]:
    published = row.paper
    if published is None:
        return (_DASH,) * len(_ROLLOUT)
    means = (_number(published.ne_mean_m, 3), _number(published.tl_mean_m), _number(published.tl_median_m))
    return (
        _number(published.n, 0),
        _percent(published.share),
        *means,
        _number(published.steps_mean, 1),
        _number(published.steps_median, 1),
    )


def _print_counts(name: str, rows: Sequence[CountRow], beside: bool) -> None:
    body = []
    for row in rows:
        paper_cells = (_number(row.paper.n, 0), _percent(row.paper.share)) if row.paper else (_DASH, _DASH)
        body.append((row.group, row.kind, str(row.n), _percent(row.share), *(paper_cells if beside else ())))
    _table((name, "kind", "N", "share", *(("paper N", "paper share") if beside else ())), body)


def _print_attempts(rows: Sequence[AttemptRow] | None, beside: bool) -> None:
    if rows is None:
        return
    body = [
        (
            row.group,
            str(row.attempts),
            str(row.success.count),
            _interval(row.success),
            _interval(row.first),
            _percent(row.collision.share),
            _percent(row.timeout.share),
            ", ".join(f"{count} {reason}" for reason, count in row.reasons.items()) or _DASH,
            *((_published_rate(row),) if beside else ()),
        )
        for row in rows
    ]
    columns = ("scene / tier", "attempts", "succeeded", "success", "first attempts", "collision", "timeout", "failures")
    _table((*columns, *(("paper success",) if beside else ())), body)


def _published_rate(row: AttemptRow) -> str:
    if row.paper is None or row.paper.rate is None:
        return _DASH
    return "-".join(f"{100 * end:.0f}" for end in row.paper.rate) + " %"


def _print_cells(statistics: Statistics) -> None:
    body = [
        (row.scene, row.split, row.tier, str(row.planned), str(row.archived), _number(row.attempts, 0))
        for row in statistics.cells
    ]
    _table(("scene", "split", "tier", "planned", "archived", "attempts"), body)


def _print_errors(title: str, rows: Sequence[ErrorRow], radius_m: float, beside: bool) -> None:
    levels = next((list(row.quantiles) for row in rows if row.quantiles), [])
    body = []
    for row in rows:
        quantiles = [_number(row.quantiles.get(level), 3) for level in levels]
        paper_cells = (_number(row.paper.ne_mean_m, 3), _number(row.paper.ne_std_m, 4)) if row.paper else (_DASH, _DASH)
        within = _percent(row.within_radius.share)
        numbers = (_number(row.mean, 3), _number(row.std, 4), *quantiles, within)
        body.append((row.group, str(row.n), *numbers, *(paper_cells if beside else ())))
    within_name = f"<= {radius_m:g} m"
    published = ("paper mean", "paper std") if beside else ()
    _table((title, "N", "mean", "std", *levels, within_name, *published), body)


def _print_fits(fits: Sequence[Fit]) -> None:
    _table(
        ("TL vs. start distance", "N", "r", "95 % interval", "p", "slope m/m", "intercept m", "remark"),
        [_fit_cells(fit) for fit in fits],
    )


def _fit_cells(fit: Fit) -> tuple[str, ...]:
    if fit.r is None or fit.low is None or fit.high is None:
        return (fit.group, str(fit.n), *(_DASH,) * 5, fit.remark)
    slope = _number(fit.slope, 3) + ("" if fit.slope_error is None else f" +- {fit.slope_error:.3f}")
    p = _DASH if fit.p is None else "< 0.001" if fit.p <= 0.001 else f"{fit.p:.3f}"
    interval = f"{fit.low:.3f} to {fit.high:.3f}"
    return (fit.group, str(fit.n), _number(fit.r, 3), interval, p, slope, _number(fit.intercept_m, 3), fit.remark)


def _print_overlap(statistics: Statistics) -> None:
    body = [
        (row.scene, row.split, str(row.targets), str(row.shared), _percent(row.share), str(row.episodes_on_shared))
        for row in statistics.overlap
    ]
    _table(("scene", "split", "targets", "also in train_id", "share", "episodes with shared targets"), body)


def _print_far(rows: Sequence[FarRow]) -> None:
    body = [
        (row.scene, str(row.n), _number(row.mean_m), _ends(row.interval_m), _interval(row.short), _interval(row.corner))
        for row in rows
        if row.n
    ]
    if body:
        below = f"below {rows[0].least_m:g} m"
        _table(("far starts", "N", "floor distance", "95 % interval", below, "without a free line"), body)


def _ends(interval: tuple[float, float] | None) -> str:
    return _DASH if interval is None else f"{interval[0]:.2f} to {interval[1]:.2f}"


def _table(columns: Sequence[str], body: Sequence[Sequence[str]]) -> None:
    by_column = [_aligned([name, *cells]) for name, *cells in zip(columns, *body, strict=True)]
    head, *rows = zip(*by_column, strict=True)
    click.echo()
    print_table("", head, rows)


def _aligned(cells: Sequence[str]) -> list[str]:
    """Aligns the heading and the cells of a column of numbers to the right."""
    width = max(map(len, cells))
    is_number = all(cell[:1].isdigit() or cell.startswith(_DASH) for cell in cells[1:])
    return [cell.rjust(width) if is_number else cell for cell in cells]


def _number(value: float | None, digits: int = 2) -> str:
    return _DASH if value is None else f"{value:.{digits}f}"


def _percent(share: float | None) -> str:
    return _DASH if share is None else f"{100 * share:.1f} %"


def _interval(share: Share) -> str:
    if share.share is None or share.low is None or share.high is None:
        return _DASH
    return f"{100 * share.share:.0f} % ({100 * share.low:.0f}-{100 * share.high:.0f})"
