"""The page of `factory train rounds`: a curve of the success rate and of the failures by round."""

from __future__ import annotations

from factory.eval.results.rounds_page import write_rounds_page
from tests.builders.eval_results import evaluation_of


def test_the_page_shows_each_round_with_intervals_and_links() -> None:
    evaluation = evaluation_of("round_0", "round_1", "round_2")
    page = write_rounds_page("rounds: training in rounds", evaluation, [("training of round 0", "policy_0/index.html")])
    assert "2 rounds" in page
    assert page.count("<svg") >= 2, "success and failures"
    assert all(f"round_{number}" in page for number in range(3))
    assert "19 to 81" in page  # Wilson interval of 3 of 6
    assert 'href="policy_0/index.html"' in page


def test_the_same_results_give_the_same_bytes() -> None:
    evaluation = evaluation_of("round_0", "round_1")
    assert write_rounds_page("a", evaluation, []) == write_rounds_page("a", evaluation, [])
