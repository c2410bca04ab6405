"""Comparisons of policies: correction for their number, conclusions, power before a run, and the episodes to show."""

from __future__ import annotations

from collections.abc import Sequence
from math import comb

import pytest

from factory.eval.models.result import EpisodeResult, Variant
from factory.eval.results.compare import choose_different, compare, compare_all, pairs_of, require_common
from factory.eval.results.estimate import mcnemar_p, needed_pairs, power, resolved_difference
from factory.eval.results.page import EpisodeFilm, write_comparison_page
from factory.eval.results.summary_text import conclusion, resolution
from schemas.errors import UsageError
from tests.builders.eval_results import result_of
from tests.builders.html import Outline


def run(policy: str, wins: Sequence[bool]) -> list[EpisodeResult]:
    return [result_of(number, policy=policy, success=win) for number, win in enumerate(wins, 1)]


def test_a_significant_difference_is_a_sentence_with_the_better_policy_first() -> None:
    good, bad = run("good", [True] * 18 + [False] * 2), run("bad", [True] * 5 + [False] * 15)
    text = conclusion(compare(bad, good, Variant.ORIGINAL))
    assert text.startswith("good succeeds more often than bad: by 65.0 points [")
    assert "in 20 episodes (p = 0.00024)" in text
    assert conclusion(compare(good, bad, Variant.ORIGINAL)) == text


def test_without_a_significant_difference_the_sentence_says_what_the_episodes_resolve() -> None:
    text = conclusion(compare(run("a", [True, False] * 10), run("b", [True] * 20), Variant.ORIGINAL, 60))
    assert text.startswith("No difference between a and b is shown in 20 episodes: +50.0 points [")
    assert text.endswith("(p = 0.12, corrected for 60 comparisons); 20 episodes resolve 67 points")


def test_several_policies_are_compared_with_corrected_tests_and_intervals_that_agree_with_them() -> None:
    runs = [run(name, [number < wins for number in range(30)]) for name, wins in (("a", 9), ("b", 16), ("c", 17))]
    found = compare_all(runs)
    assert [(entry.first, entry.second) for entry in found] == [("a", "b"), ("a", "c"), ("b", "c")]
    for entry in found:
        assert entry.corrected_p == pytest.approx(min(1.0, 3 * entry.p))
        assert entry.success_difference.low is not None
        assert entry.success_difference.high is not None
        excludes_zero = not entry.success_difference.low <= 0.0 <= entry.success_difference.high
        assert excludes_zero == entry.is_significant
    alone = compare(runs[0], runs[1], Variant.ORIGINAL)
    assert alone.corrected_p is None
    assert alone.is_significant
    wide, narrow = found[0].success_difference, alone.success_difference
    assert wide.high is not None
    assert narrow.high is not None
    assert wide.high > narrow.high


def test_policies_without_a_common_episode_are_refused() -> None:
    ones, others = [result_of(1, policy="a")], [result_of(2, policy="b")]
    with pytest.raises(UsageError, match="evaluate all with the same --specs"):
        require_common(compare_all([ones, others]), Variant.ORIGINAL)


@pytest.mark.parametrize(
    ("pairs", "difference", "comparisons"), [(15, 0.3, 1), (12, 0.6, 2), (30, 0.1, 1), (8, 0.9, 1)]
)
def test_the_power_is_the_probability_of_a_rejection(pairs: int, difference: float, comparisons: int) -> None:
    differ = max(0.2, difference)
    better, worse = (differ + difference) / 2, (differ - difference) / 2
    total = 0.0
    for wins in range(pairs + 1):
        for losses in range(pairs - wins + 1):
            if mcnemar_p(wins, losses, comparisons) < 0.05:
                ways = comb(pairs, wins) * comb(pairs - wins, losses)
                total += ways * better**wins * worse**losses * (1 - differ) ** (pairs - wins - losses)
    assert power(pairs, difference, comparisons) == pytest.approx(total, abs=1e-12)


def test_200_episodes_resolve_nine_points_and_five_resolve_nothing() -> None:
    least = resolved_difference(200)
    assert least == pytest.approx(0.091, abs=0.001)
    assert resolution(200) == "200 episodes resolve 10 points"
    assert resolution(5) == "5 episodes resolve no difference"
    assert resolved_difference(200, comparisons=3) == pytest.approx(0.104, abs=0.001)
    needed = needed_pairs(0.091)
    assert needed is not None
    assert abs(needed - 200) < 10
    assert needed_pairs(0.0001) is None


def test_shown_episodes_are_of_both_kinds() -> None:
    first = run("a", [True] * 6 + [False] * 6)
    second = run("b", [False] * 6 + [True] * 2 + [False] * 4)
    pairs = pairs_of(first, second, Variant.ORIGINAL)
    for count, numbers in ((0, []), (2, [1, 7]), (4, [1, 2, 7, 8]), (6, [1, 2, 3, 4, 7, 8]), (9, [*range(1, 9)])):
        assert [int(one.spec_id[-6:]) for one, _ in choose_different(pairs, count)] == numbers


def test_the_page_shows_conclusions_and_both_ends_of_different_episodes() -> None:
    first, second = run("<b>a", [True] * 9), run("b", [False] * 9)
    films = [EpisodeFilm((first[0], second[0]), b"film", b"poster")]
    page = write_comparison_page(compare_all([first, second]), {("<b>a", "b"): films})
    outline = Outline(page)
    assert "&lt;b&gt;a succeeds more often than b" in page
    assert "Videos of 1 of 9 episodes that only one of" in page
    assert "below, b: timeout, NE 3.00 m, 100 steps" in page
    assert {link[1:] for link in outline.links if link.startswith("#")} <= set(outline.ids)
