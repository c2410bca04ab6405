"""This dataset's numbers beside the paper's, with the difference and, where it is one, the reason. Pure.

The numbers are those of `factory.stats`; the reasons come from `reasons`.
"""

from __future__ import annotations

from collections.abc import Iterator

from factory.report import reasons
from factory.report.comparison import PaperComparison
from factory.report.facts import RunFacts, facts_of
from factory.report.material import ReportInput
from factory.stats import paper
from factory.stats.model import RolloutRow
from factory.stats.rollouts import ALL
from schemas.language import needs_colour, say_category
from schemas.terms import Split, Tier

__all__ = ["compare"]

_ALIKE = 0.05
"""Relative difference up to which lengths and steps need no reason."""
_ALIKE_NE_M, _ALIKE_SPREAD_M = 0.005, 0.001
_ALIKE_SHARE = 0.02


def compare(material: ReportInput) -> tuple[PaperComparison, ...]:
    """Returns every number that the paper prints and that this dataset has; none where it is not compared."""
    if not material.episodes or not material.statistics.beside_paper:
        return ()
    return (
        *_lengths(material),
        *_errors(material),
        *_steps(material),
        *_tiers(material),
        *_tier_shares(material),
        *_splits(material),
        *_categories(material),
        *_fit(material),
        *_templates(material),
        *_attempts(material),
    )


def _lengths(material: ReportInput) -> Iterator[PaperComparison]:
    for row in material.statistics.scenes:
        yield from _length(material, "lengths", row, _facts(material, row.group))
        if row.paper and row.paper.tl_median_m is not None:
            differ = row.tl_median_m is not None and _differ(row.tl_median_m, row.paper.tl_median_m)
            yield PaperComparison(
                exhibit="lengths",
                what="TL median, all",
                ours=row.tl_median_m,
                published=row.paper.tl_median_m,
                unit="m",
                digits=2,
                source=row.paper.source,
                reason="For the same reason as the mean." if differ else "",
            )


def _length(material: ReportInput, exhibit: str, row: RolloutRow, facts: RunFacts | None) -> Iterator[PaperComparison]:
    said = row.paper
    if said is None or said.tl_mean_m is None:
        return
    published_ne = said.ne_mean_m if said.ne_mean_m is not None else paper.OVERALL.ne_mean_m
    reason = ""
    if facts and row.tl_mean_m is not None and _differ(row.tl_mean_m, said.tl_mean_m) and published_ne is not None:
        mix = reasons.say_mix(facts) if exhibit in {"lengths", "splits"} else ""
        reason = reasons.say_length(facts, said.tl_mean_m, published_ne) + mix
        if row.group == ALL and exhibit == "lengths":
            reason += reasons.say_standardised(material.statistics)
    yield PaperComparison(
        exhibit=exhibit,
        what=f"TL mean, {row.group if exhibit == 'splits' else _said(row.group)}",
        ours=row.tl_mean_m,
        published=said.tl_mean_m,
        unit="m",
        digits=2,
        source=said.source,
        reason=reason,
    )


def _errors(material: ReportInput) -> Iterator[PaperComparison]:
    said = paper.NAVIGATION_ERROR
    row = next(row for row in material.statistics.navigation_error if row.group == ALL)
    for what, ours, published, digits, alike in (
        ("NE mean", row.mean, said.ne_mean_m, 3, _ALIKE_NE_M),
        ("NE standard deviation", row.std, said.ne_std_m, 4, _ALIKE_SPREAD_M),
    ):
        if published is None:
            continue
        differ = ours is not None and abs(ours - published) > alike
        yield PaperComparison(
            exhibit="errors",
            what=what,
            ours=ours,
            published=published,
            unit="m",
            digits=digits,
            source=said.source,
            reason=reasons.say_error(material.statistics) if differ else "",
        )


def _steps(material: ReportInput) -> Iterator[PaperComparison]:
    for row in material.statistics.scenes:
        said = row.paper
        if said is None or said.steps_median is None:
            continue
        facts = _facts(material, row.group)
        differ = row.steps_median is not None and _differ(row.steps_median, said.steps_median)
        reason = reasons.say_steps(facts, said) + reasons.say_floor(material, row.group) if facts and differ else ""
        yield PaperComparison(
            exhibit="steps",
            what=f"steps median, {_said(row.group)}",
            ours=row.steps_median,
            published=said.steps_median,
            unit="steps",
            digits=0,
            source=said.source,
            reason=reason,
        )


def _tiers(material: ReportInput) -> Iterator[PaperComparison]:
    for row in material.statistics.tiers:
        said = row.paper
        if said is None or said.steps_mean is None:
            continue
        members = [episode for episode in material.episodes if row.group in (ALL, episode.spawn_tier)]
        facts = facts_of(members)
        if row.group != ALL:  # that one stands beside the histogram
            yield from _length(material, "tier_statistics", row, facts)
        differ = row.steps_mean is not None and _differ(row.steps_mean, said.steps_mean)
        yield PaperComparison(
            exhibit="tier_statistics",
            what=f"steps mean, {row.group}",
            ours=row.steps_mean,
            published=said.steps_mean,
            unit="steps",
            digits=1,
            source=said.source,
            reason=reasons.say_steps(facts, said) if facts and differ else "",
        )
        if row.group != ALL and said.ne_mean_m is not None:
            off = row.ne_mean_m is not None and abs(row.ne_mean_m - said.ne_mean_m) > _ALIKE_NE_M
            yield PaperComparison(
                exhibit="tier_statistics",
                what=f"NE mean, {row.group}",
                ours=row.ne_mean_m,
                published=said.ne_mean_m,
                unit="m",
                digits=3,
                source=said.source,
                reason=reasons.say_error(material.statistics) if off else "",
            )


def _tier_shares(material: ReportInput) -> Iterator[PaperComparison]:
    for row in material.statistics.tiers:
        if row.paper is None or row.paper.share is None:
            continue
        tier = Tier(row.group)
        asked = material.meta.plan.tier_share(tier)
        differ = row.share is not None and abs(row.share - row.paper.share) > _ALIKE_SHARE
        yield _share(
            "tiers",
            f"share of {row.group}",
            row.share,
            row.paper.share,
            row.paper.source,
            reasons.say_planned(material.statistics, tier, asked, row.paper.n) if differ else "",
        )


def _splits(material: ReportInput) -> Iterator[PaperComparison]:
    for row in material.statistics.splits:
        if row.paper is None or row.paper.n is None or paper.OVERALL.n is None or row.group == ALL:
            continue
        published = row.paper.n / paper.OVERALL.n
        split = Split(row.group)
        asked = material.meta.plan.split_share(split)
        differ = row.share is not None and abs(row.share - published) > _ALIKE_SHARE
        reason = reasons.say_planned(material.statistics, split, asked, row.paper.n) if differ else ""
        yield _share("splits", f"share of {row.group}", row.share, published, row.paper.source, reason)
        members = [each for each in material.episodes if each.split == row.group]
        yield from _length(material, "splits", row, facts_of(members))


def _categories(material: ReportInput) -> Iterator[PaperComparison]:
    rows = {row.group: row for row in material.statistics.categories}
    for name, said in paper.CATEGORIES.items():
        ours = rows[name].share if name in rows else 0.0
        if said.share is None:
            continue
        differ = ours is not None and abs(ours - said.share) > _ALIKE_SHARE
        reason = reasons.say_category_share(material, name) if differ else ""
        yield _share("categories", f"share of {say_category(name)}", ours, said.share, said.source, reason)
    largest = material.statistics.three_largest_share
    differ = largest is not None and abs(largest - paper.THREE_LARGEST_SHARE) > _ALIKE_SHARE
    reason = reasons.say_largest(material.statistics) if differ else ""
    published = paper.THREE_LARGEST_SHARE
    yield _share("categories", "share of the three most frequent", largest, published, "Sec. VIII", reason)


def _fit(material: ReportInput) -> Iterator[PaperComparison]:
    ours, said = material.statistics.correlation[0], paper.FIT
    if said.r is None or said.slope is None:
        return
    outside = ours.low is not None and ours.high is not None and not ours.low <= said.r <= ours.high
    reason = reasons.say_correlation(facts_of(material.episodes)) if outside else ""
    yield _plain("fit", "Pearson r", ours.r, said.r, "Fig. 11", reason)
    off = ours.slope is not None and ours.slope_error is not None and abs(ours.slope - said.slope) > 0.05
    reason = reasons.say_slope(material.statistics) if off else ""
    yield _plain("fit", "slope, m/m", ours.slope, said.slope, "Fig. 11", reason)


def _templates(material: ReportInput) -> Iterator[PaperComparison]:
    with_colour = [row for row in material.statistics.templates if row.group in paper.TEMPLATE_COUNTS]
    share = sum(row.n for row in with_colour) / len(material.episodes)
    reason = reasons.say_colours(material) if share else ""
    yield _share("templates", "share with a colour word", share, 0.0, "Fig. 12", reason)
    used = {row.group for row in material.statistics.templates if row.n and not needs_colour(row.group)}
    yield _plain("templates", "templates in use without colour", len(used), 13 + 10, "Table III", "", digits=0)


def _attempts(material: ReportInput) -> Iterator[PaperComparison]:
    for row in material.statistics.attempts or ():
        if row.paper is None or row.paper.rate is None:
            continue
        low, high = row.paper.rate
        rate = row.success.share
        yield PaperComparison(
            exhibit="attempts",
            what=f"attempts that succeed, {_said(row.group)}",
            ours=rate,
            published=low,
            published_high=high,
            unit="share",
            digits=1,
            source=row.paper.source,
            reason="" if rate is None or low <= rate <= high else reasons.say_success(material, row),
        )


def _share(exhibit: str, what: str, ours: float | None, published: float, source: str, reason: str) -> PaperComparison:
    return PaperComparison(
        exhibit=exhibit,
        what=what,
        ours=ours,
        published=published,
        unit="share",
        digits=1,
        source=source,
        reason=reason,
    )


def _plain(
    exhibit: str, what: str, ours: float | None, published: float, source: str, reason: str, digits: int = 2
) -> PaperComparison:
    return PaperComparison(
        exhibit=exhibit, what=what, ours=ours, published=published, unit="", digits=digits, source=source, reason=reason
    )


def _facts(material: ReportInput, scene: str) -> RunFacts | None:
    return facts_of([row for row in material.episodes if scene in (ALL, row.scene)])


def _differ(ours: float, published: float) -> bool:
    return abs(ours - published) > _ALIKE * abs(published)


def _said(group: str) -> str:
    return group.replace("_", " ")
