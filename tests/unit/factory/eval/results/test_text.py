"""Tables of evaluations on the terminal: at most 80 columns, with the names of the web page."""

from __future__ import annotations

import pytest

from factory.eval.models.result import Variant
from factory.eval.results.compare import compare
from factory.eval.results.text import print_comparison, print_evaluation
from factory.html.measures import TITLES
from tests.builders.eval_results import evaluation_of, result_of

LONG = "my_package.policies.navigation:HistoryPolicy"


@pytest.mark.parametrize("names", [("expert", "stop"), ("bc:checkpoints/run_0042", LONG)])
def test_all_tables_are_at_most_80_columns_wide(names: tuple[str, str], capsys: pytest.CaptureFixture[str]) -> None:
    print_evaluation(evaluation_of(*names), all_tables=True)
    text = capsys.readouterr().out
    tables, _, texts = text.partition(f"\n\n{names[0]}: input:")
    assert max(map(len, tables.splitlines()[1:])) <= 80
    for title in ("SR, %", "SPL", "NE, m", "OP closest", "policy failure, %"):
        assert tables.count(title) >= 2, title
    assert "NE: navigation error: planar distance" in texts


def test_a_comparison_names_measures_as_the_page_does(capsys: pytest.CaptureFixture[str]) -> None:
    ones, others = ([result_of(number, policy=name) for number in (1, 2)] for name in (f"other_{LONG}", LONG))
    print_comparison(compare(ones, others, Variant.ORIGINAL))
    lines = capsys.readouterr().out.splitlines()
    tables = [
        line for line in lines if not line.startswith(("succeeded: ", "No difference ")) and " minus " not in line
    ]
    assert max(map(len, tables)) <= 80
    for title in ("SR, points", *list(TITLES.values())[1:]):
        assert any(line.startswith(f"{title}  ") for line in lines), title
