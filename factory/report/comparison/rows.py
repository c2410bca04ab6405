"""Compares the numbers of a dataset with the paper, with a reason for each noticeable difference. Pure functions.

Takes numbers from `factory.stats` and reasons from `reasons`.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any, NamedTuple

from factory.report.comparison import reasons
from factory.report.comparison.paper_comparison import PaperComparison, verdict_of
from factory.report.comparison.reasons import RunFacts, facts_of
from factory.report.data import ReportInput
from factory.stats import paper
from factory.stats.counts import first_of_near_and_mid
from factory.stats.measures import share_of
from factory.stats.rollouts import ALL
from factory.stats.statistics import Interval, Published, RolloutRow, Share
from schemas.instruction.templates import needs_colour, say_category
from schemas.terms import Split, Tier


class _Kind(NamedTuple):
    """Format of a number, and threshold of a noticeable difference."""

    unit: str
    digits: int
    alike: float = 0.0
    """Absolute threshold, in the unit of the number."""
    alike_relative: float = 0.0
    """Threshold relative to the published number."""

    def target(self, published: float) -> Interval:
        """Returns the smallest and the largest number that do not differ noticeably from the published number."""
        threshold = self.alike + self.alike_relative * abs(published)
        return published - threshold, published + threshold


_KINDS = {
    "TL": _Kind("m", 2, alike_relative=0.05),
    "far TL": _Kind("m", 2, alike_relative=0.15),
    "far steps mean": _Kind("steps", 1, alike_relative=0.15),
    "steps median": _Kind("steps", 0, alike_relative=0.05),
    "steps mean": _Kind("steps", 1, alike_relative=0.05),
    "NE": _Kind("m", 3, 0.005),
    "NE spread": _Kind("m", 4, 0.001),
    "share": _Kind("share", 1, 0.02),
    "share of colours": _Kind("share", 1),
    "r": _Kind("", 2, 0.02),
    "slope": _Kind("", 2, 0.05),
    "count": _Kind("", 0),
}


def compare(material: ReportInput) -> tuple[PaperComparison, ...]:
    """Returns the comparisons of all numbers that both the paper and the dataset have; empty if disabled."""
    if not material.episodes or not material.statistics.beside_paper:
        return ()
    groups = (_lengths, _errors, _steps, _tiers, _tier_shares, _splits, _categories, _fit, _templates, _attempts)
    return tuple(comparison for group in groups for comparison in group(material))


def _compare(
    figure: str,
    what: str,
    kind: str,
    ours: float | None,
    published: float | None,
    source: str,
    explain: Callable[..., str],
    *arguments: Any,
    interval: Interval | None = None,
) -> Iterator[PaperComparison]:
    """Yields the comparison of one number; `explain(*arguments)` returns the reason for a noticeable difference."""
    if published is None:
        return
    target = _KINDS[kind].target(published)
    yield PaperComparison(
        exhibit=figure,
        what=what,
        ours=ours,
        published=published,
        interval=interval,
        target=target if interval else None,
        verdict=verdict_of(interval, target),
        unit=_KINDS[kind].unit,
        digits=_KINDS[kind].digits,
        source=source,
        reason="" if ours is None or target[0] <= ours <= target[1] else explain(*arguments),
    )


def _lengths(material: ReportInput) -> Iterator[PaperComparison]:
    for row in material.statistics.scenes:
        yield from _length(material, "lengths", row, _facts(material, row.group))
        if paper_value := row.paper:
            ours, published, same = row.tl_median_m, paper_value.tl_median_m, "The reason is the same as for the mean."
            yield from _compare("lengths", "TL median, all", "TL", ours, published, paper_value.source, str, same)


def _length(material: ReportInput, figure: str, row: RolloutRow, facts: RunFacts | None) -> Iterator[PaperComparison]:
    if paper_value := row.paper:
        what = f"TL mean, {row.group if figure == 'splits' else _group_label(row.group)}"
        ours, published = row.tl_mean_m, paper_value.tl_mean_m
        kind, why = _kind("TL", row), (_why_length, material, figure, row.group, facts, paper_value)
        yield from _compare(figure, what, kind, ours, published, paper_value.source, *why, interval=row.tl_interval_m)


def _kind(name: str, row: RolloutRow) -> str:
    """Returns the key of `_KINDS`; far starts have a larger threshold, because the paper has only 14 far episodes."""
    return f"far {name}" if row.group == Tier.FAR else name


def _why_length(material: ReportInput, figure: str, group: str, facts: RunFacts | None, published: Published) -> str:
    published_ne = published.ne_mean_m if published.ne_mean_m is not None else paper.OVERALL.ne_mean_m
    if facts is None or published.tl_mean_m is None or published_ne is None:
        return ""
    text = reasons.explain_length(facts, published.tl_mean_m, published_ne)
    if figure in {"lengths", "splits"}:
        text += reasons.explain_mix(facts)
    if group == ALL and figure == "lengths":
        text += reasons.explain_standardised(material.statistics)
    return text


def _errors(material: ReportInput) -> Iterator[PaperComparison]:
    published, why = paper.NAVIGATION_ERROR, (reasons.explain_error, material.statistics)
    row = next(row for row in material.statistics.navigation_error if row.group == ALL)
    yield from _compare(
        "errors", "NE mean", "NE", row.mean, published.ne_mean_m, published.source, *why, interval=row.interval
    )
    yield from _compare(
        "errors", "NE standard deviation", "NE spread", row.std, published.ne_std_m, published.source, *why
    )


def _steps(material: ReportInput) -> Iterator[PaperComparison]:
    for row in material.statistics.scenes:
        if paper_value := row.paper:
            what, ours, published = (
                f"steps median, {_group_label(row.group)}",
                row.steps_median,
                paper_value.steps_median,
            )
            why = (_why_steps, _facts(material, row.group), paper_value, (material, row.group))
            yield from _compare("steps", what, "steps median", ours, published, paper_value.source, *why)


def _why_steps(facts: RunFacts | None, published: Published, floor: tuple[ReportInput, str] | None = None) -> str:
    if facts is None:
        return ""
    return reasons.explain_steps(facts, published) + (reasons.explain_floor(*floor) if floor else "")


def _tiers(material: ReportInput) -> Iterator[PaperComparison]:
    for row in material.statistics.tiers:
        published = row.paper
        if published is None or published.steps_mean is None:
            continue
        facts = facts_of([episode for episode in material.episodes if row.group in (ALL, episode.spawn_tier)])
        if row.group != ALL:  # the figure of trajectory lengths compares the mean of all tiers
            yield from _length(material, "tier_statistics", row, facts)
        what, kind, why = f"steps mean, {row.group}", _kind("steps mean", row), (_why_steps, facts, published)
        numbers = (row.steps_mean, published.steps_mean, published.source)
        yield from _compare("tier_statistics", what, kind, *numbers, *why, interval=row.steps_interval)
        if row.group != ALL:
            what, ours = f"NE mean, {row.group}", row.ne_mean_m
            error = (published.source, reasons.explain_error, material.statistics)
            yield from _compare(
                "tier_statistics", what, "NE", ours, published.ne_mean_m, *error, interval=row.ne_interval_m
            )


def _tier_shares(material: ReportInput) -> Iterator[PaperComparison]:
    for row in material.statistics.tiers:
        if (published := row.paper) and published.share is not None:
            tier = Tier(row.group)
            why = (reasons.explain_planned, material.statistics, tier, material.meta.plan.tier_share(tier), published.n)
            yield from _compare(
                "tiers", f"share of {tier}", "share", row.share, published.share, published.source, *why
            )


def _splits(material: ReportInput) -> Iterator[PaperComparison]:
    for row in material.statistics.splits:
        paper_value = row.paper
        if paper_value is None or paper_value.n is None or paper.OVERALL.n is None or row.group == ALL:
            continue
        split, published = Split(row.group), paper_value.n / paper.OVERALL.n
        why = (
            reasons.explain_planned,
            material.statistics,
            split,
            material.meta.plan.split_share(split),
            paper_value.n,
        )
        yield from _compare("splits", f"share of {split}", "share", row.share, published, paper_value.source, *why)
        yield from _length(
            material, "splits", row, facts_of([each for each in material.episodes if each.split == split])
        )


def _categories(material: ReportInput) -> Iterator[PaperComparison]:
    rows, total = material.statistics.categories, len(material.episodes)
    counts = {row.group: share_of(row.n, total) for row in rows}
    for name, published in paper.CATEGORIES.items():
        ours, why = counts.get(name) or share_of(0, total), (reasons.explain_category_share, material, name)
        yield from _category_share(f"share of {say_category(name)}", ours, published.share, published.source, *why)
    ours, why_largest = share_of(sum(row.n for row in rows[:3]), total), (reasons.explain_largest, material.statistics)
    what = "share of the three most frequent categories"
    yield from _category_share(what, ours, paper.THREE_LARGEST_SHARE, "Sec. VIII", *why_largest)


def _category_share(
    what: str, ours: Share, published: float | None, source: str, *explain: Any
) -> Iterator[PaperComparison]:
    interval = _ends(ours.low, ours.high)
    yield from _compare("categories", what, "share", ours.share, published, source, *explain, interval=interval)


def _ends(low: float | None, high: float | None) -> Interval | None:
    return None if low is None or high is None else (low, high)


def _fit(material: ReportInput) -> Iterator[PaperComparison]:
    ours, published = material.statistics.correlation[0], paper.FIT
    why_r = (reasons.explain_correlation, facts_of(material.episodes))
    interval = _ends(ours.low, ours.high)
    yield from _compare("fit", "Pearson r", "r", ours.r, published.r, "Fig. 11", *why_r, interval=interval)
    why_slope = (reasons.explain_slope, material.statistics)
    yield from _compare("fit", "slope, m/m", "slope", ours.slope, published.slope, "Fig. 11", *why_slope)


def _templates(material: ReportInput) -> Iterator[PaperComparison]:
    with_colour = [row for row in material.statistics.templates if row.group in paper.TEMPLATE_COUNTS]
    share, why = sum(row.n for row in with_colour) / len(material.episodes), (reasons.explain_colours, material)
    yield from _compare("templates", "share with a colour word", "share of colours", share, 0.0, "Fig. 12", *why)
    used = {row.group for row in material.statistics.templates if row.n and not needs_colour(row.group)}
    yield from _compare("templates", "templates in use without colour", "count", len(used), 13 + 10, "Table III", str)


def _attempts(material: ReportInput) -> Iterator[PaperComparison]:
    rows = material.statistics.attempts or ()
    for row in rows:
        if row.paper is None or row.paper.rate is None:
            continue
        first = first_of_near_and_mid(rows, row.group)
        (low, high), rate, interval = row.paper.rate, first.share, _ends(first.low, first.high)
        yield PaperComparison(
            exhibit="attempts",
            what=f"first near and mid attempts that succeed, {_group_label(row.group)}",
            ours=rate,
            published=low,
            published_high=high,
            interval=interval,
            target=row.paper.rate if interval else None,
            verdict=verdict_of(interval, row.paper.rate),
            unit="share",
            digits=1,
            source=row.paper.source,
            reason="" if rate is None or low <= rate <= high else reasons.explain_success(material, row),
        )


def _facts(material: ReportInput, scene: str) -> RunFacts | None:
    return facts_of([row for row in material.episodes if scene in (ALL, row.scene)])


def _group_label(group: str) -> str:
    return group.replace("_", " ")
