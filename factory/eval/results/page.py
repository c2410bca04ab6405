"""Builds the content of the evaluation page: tables, texts and videos for `evaluation.html`. Writes no files."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

from factory.eval.models.result import EpisodeResult
from factory.eval.results.compare import PairedComparison
from factory.eval.results.estimate import IntervalEstimate
from factory.eval.results.score import GROUPS, Evaluation, PolicyScores, Score, side_by_side
from factory.eval.results.summary_text import (
    ABLATION_HEAD,
    ASSUMED,
    FAILURES,
    INTERVALS,
    ablation_rows,
    conclusion,
    describe_ends,
    failure_kinds,
    failure_rows,
    fault_lines,
    policies_without_instruction,
)
from factory.html import data_uri, render
from factory.html.measures import TITLES
from factory.stats.statistics import Share

_HEAD = (
    "n",
    "SR, %",
    "oracle success, %",
    "any instance, %",
    *(
        TITLES[name]
        for name in (
            *("spl", "soft_spl", "ne_m", "ne_centroid_m", "ne_surface_m"),
            *("progress_final", "progress_max", "progress_normalised", "trajectory_length_m", "num_steps"),
        )
    ),
    "collision, %",
    "contact, %",
    "timeout, %",
    "policy failure, %",
)
_MAIN_HEAD = ("SR, %", "SPL", "NE, m", "collision, %", "n")
_DASH = "–"


Names = tuple[str, ...]
"""Names of one policy, whose failures are shown, or of two, whose different episodes are shown."""


@dataclass(frozen=True)
class EpisodeFilm:
    """Episode of one policy, or of two, with its video (MP4) and the last picture of the video (JPEG)."""

    rows: tuple[EpisodeResult, ...]
    film: bytes
    poster: bytes


@dataclass(frozen=True)
class MeasureCell:
    """Table cell: a value and its interval; for a rate, also their positions in a bar."""

    value: str
    interval: str = ""
    ends: tuple[float, float, float] | None = None
    """Lower end, value and upper end, per cent; `None` without a bar."""


@dataclass(frozen=True)
class MeasureTable:
    """Table of several policies, grouped."""

    anchor: str
    title: str
    head: Sequence[str]
    groups: Sequence[tuple[str, Sequence[Sequence[MeasureCell]]]]
    """Group names with their rows; the first cell of a row is its name."""
    note: str = ""


def write_page(evaluation: Evaluation, shown: Mapping[Names, Sequence[EpisodeFilm]]) -> str:
    """Returns the evaluation page as HTML.

    Args:
        evaluation: All tables.
        shown: Videos to show: failures of each policy, and different episodes of each pair of policies.
    """
    policies = evaluation.policies
    films = [(policy, shown[(policy.policy,)]) for policy in policies if shown.get((policy.policy,))]
    return render(
        "evaluation.html",
        title=f"{evaluation.run}: evaluation",
        kicker="Evaluation of policies",
        run=evaluation.run,
        badges=list(_badges(evaluation)),
        digest=("specs digest", evaluation.specs_digest),
        contents=[
            ("overview", "Main metrics"),
            *([("comparison", "Comparison")] if evaluation.comparisons else ()),
            ("measures", "All measures"),
            *((f"failures_{place}", f"Failures of {policy.policy}") for place, (policy, _) in enumerate(films, 1)),
            ("method", "Method"),
        ],
        evaluation=evaluation,
        intervals=INTERVALS,
        main={
            "head": _MAIN_HEAD,
            "rows": [(policy.policy, policy.described, _main_cells(policy.overall)) for policy in policies],
        },
        comparisons=_sections(evaluation.comparisons, shown),
        assumed=ASSUMED,
        faults=[line for policy in policies for line in fault_lines(policy)],
        ends=[(policy.policy, describe_ends(policy)) for policy in policies],
        tables=list(tables_of(policies)),
        films=[(policy.policy, _failed(policy), [_failure(film) for film in some]) for policy, some in films],
    )


def write_comparison_page(comparisons: Sequence[PairedComparison], shown: Mapping[Names, Sequence[EpisodeFilm]]) -> str:
    """Returns the page of comparisons as HTML.

    Args:
        comparisons: Comparisons, at least one.
        shown: Videos of different episodes of each pair of policies.
    """
    names = list(dict.fromkeys(name for entry in comparisons for name in (entry.first, entry.second)))
    return render(
        "comparison.html",
        title="Comparison of policies",
        kicker="Comparison of policies",
        run=", ".join(names),
        badges=[
            _count(len(names), "policy", "policies"),
            f"{comparisons[0].variant} instruction",
            _count(max(entry.pairs for entry in comparisons), "episode"),
        ],
        digest=None,
        contents=[("comparison", "Comparison"), ("method", "Method")],
        comparisons=_sections(comparisons, shown),
        assumed=ASSUMED,
        intervals=INTERVALS,
    )


def _sections(
    comparisons: Sequence[PairedComparison], shown: Mapping[Names, Sequence[EpisodeFilm]]
) -> list[dict[str, object]]:
    return [
        {
            "pair": entry,
            "conclusion": conclusion(entry),
            "table": comparison_table(entry),
            "different": entry.only_first + entry.only_second,
            "films": [_different(film) for film in shown.get((entry.first, entry.second), ())],
        }
        for entry in comparisons
    ]


def _badges(evaluation: Evaluation) -> Iterator[str]:
    yield _count(evaluation.episodes, "episode")
    yield _count(len(evaluation.policies), "policy", "policies")
    yield f"success radius {evaluation.success_radius_m:g} m by {evaluation.success}"
    yield "complete" if evaluation.complete else "incomplete"


def _count(n: int, one: str, many: str = "") -> str:
    return f"{n} {one if n == 1 else many or one + 's'}"


def _failed(policy: PolicyScores) -> int:
    return policy.overall.n - policy.overall.success.count


def _main_cells(score: Score) -> Sequence[MeasureCell]:
    return (
        _share(score.success),
        _estimate(score.spl),
        _estimate(score.ne_m),
        _share(score.collision),
        MeasureCell(str(score.n)),
    )


def main_table(policies: Sequence[PolicyScores]) -> MeasureTable:
    rows = [[MeasureCell(policy.policy), *_main_cells(policy.overall)] for policy in policies]
    return MeasureTable("overview", "Main metrics", ("policy", *_MAIN_HEAD), [("", rows)])


def comparison_table(comparison: PairedComparison) -> MeasureTable:
    """Returns the success rates of a paired comparison and the mean differences, second policy minus first."""
    rates = [
        (f"SR of {comparison.first}, %", comparison.first_success),
        (f"SR of {comparison.second}, %", comparison.second_success),
    ]
    means = [
        [MeasureCell("SR, points"), _points(comparison.success_difference)],
        *([MeasureCell(TITLES[name]), _estimate(value, 3)] for name, value in comparison.differences.items()),
    ]
    return MeasureTable(
        "comparison",
        f"{comparison.second} minus {comparison.first}",
        ("kind", "measure", "value"),
        [
            ("rate", [[MeasureCell(name), _share(rate)] for name, rate in rates]),
            ("mean difference", means),
        ],
    )


def tables_of(policies: Sequence[PolicyScores]) -> Iterator[MeasureTable]:
    """Yields the measures of all policies: overall, by group, and with other instructions."""
    whole = [[MeasureCell(policy.policy), *_cells(policy.overall)] for policy in policies]
    yield MeasureTable("all", "All episodes", ("policy", *_HEAD), [("", whole)])
    if any(policy.failures for policy in policies):
        yield failure_table(policies)
    for by, title in GROUPS.items():
        groups: dict[str, list[Sequence[MeasureCell]]] = {}
        for name, policy, score in side_by_side(policies, by):
            groups.setdefault(name, []).append([MeasureCell(policy.policy), *_cells(score)])
        if groups:
            yield MeasureTable(by, title, (by, "policy", *_HEAD), list(groups.items()))
    yield from _ablations(policies)


def failure_table(policies: Sequence[PolicyScores]) -> MeasureTable:
    """Returns the shares of all kinds of failure that occurred."""
    rows = [[MeasureCell(name), *map(_share, shares)] for name, shares in failure_rows(policies)]
    return MeasureTable("failures", FAILURES, ("policy", *failure_kinds(policies)), [("", rows)])


def _ablations(policies: Sequence[PolicyScores]) -> Iterator[MeasureTable]:
    groups: dict[str, list[Sequence[MeasureCell]]] = {}
    for policy, *cells in ablation_rows(policies, _share, _points):
        groups.setdefault(str(policy), []).append(
            [cell if isinstance(cell, MeasureCell) else MeasureCell(str(cell)) for cell in cells]
        )
    if groups:
        names = ", ".join(policies_without_instruction(policies))
        note = f"Difference 0 by construction for policies that do not use the instruction: {names}." if names else ""
        yield MeasureTable(
            "words", "Instruction ablation", head=("policy", *ABLATION_HEAD), groups=list(groups.items()), note=note
        )


def _different(film: EpisodeFilm) -> dict[str, object]:
    row = film.rows[0]
    return {
        "row": row,
        "facts": f"{row.scene}, {row.tier}, {row.split}; {row.target_id}",
        "ends": [
            f"{one.policy}: {one.failure or one.end}, NE {one.final_ne_m:.2f} m, {one.num_steps} steps"
            for one in film.rows
        ],
        "source": data_uri("video/mp4", film.film),
        "poster": data_uri("image/jpeg", film.poster),
    }


def _failure(failure: EpisodeFilm) -> dict[str, object]:
    (row,) = failure.rows
    facts = f"{row.scene}, {row.tier}, {row.split}; {row.target_id}; NE {row.final_ne_m:.2f} m, {row.num_steps} steps"
    return {
        "row": row,
        "facts": facts,
        "source": data_uri("video/mp4", failure.film),
        "poster": data_uri("image/jpeg", failure.poster),
    }


def _cells(score: Score) -> Sequence[MeasureCell]:
    return (
        MeasureCell(str(score.n)),
        _share(score.success),
        _share(score.oracle_success),
        _share(score.any_instance),
        _estimate(score.spl),
        _estimate(score.soft_spl),
        _estimate(score.ne_m),
        _estimate(score.ne_centroid_m),
        _estimate(score.ne_surface_m),
        _estimate(score.progress_final),
        _estimate(score.progress_max),
        _estimate(score.progress_normalised),
        _estimate(score.trajectory_length_m),
        _estimate(score.num_steps, 0),
        _share(score.collision),
        _share(score.contact),
        _share(score.timeout),
        _share(score.policy_failure),
    )


def _share(share: Share) -> MeasureCell:
    if share.share is None or share.low is None or share.high is None:
        return MeasureCell(_DASH)
    low, value, high = 100 * share.low, 100 * share.share, 100 * share.high
    return MeasureCell(f"{value:.1f}", f"{low:.0f} to {high:.0f}", (low, value, high))


def _points(value: IntervalEstimate) -> MeasureCell:
    """Returns a difference of shares in percentage points."""
    if value.mean is None or value.low is None or value.high is None:
        return MeasureCell(_DASH)
    return MeasureCell(f"{100 * value.mean:+.1f}", f"{100 * value.low:+.0f} to {100 * value.high:+.0f}")


def _estimate(value: IntervalEstimate, digits: int = 2) -> MeasureCell:
    if value.mean is None:
        return MeasureCell(_DASH)
    if value.low is None or value.high is None:
        return MeasureCell(f"{value.mean:.{digits}f}")
    return MeasureCell(f"{value.mean:.{digits}f}", f"{value.low:.{digits}f} to {value.high:.{digits}f}")
