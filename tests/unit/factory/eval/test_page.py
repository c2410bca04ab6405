"""The page: self-contained, free of what others wrote into names, and every policy on it."""

from __future__ import annotations

import re

from factory.eval.note import PolicyNote
from factory.eval.page import write_page
from factory.eval.result import EvalEnd, Variant
from factory.eval.score import Evaluation, score_policy
from factory.eval.video import choose_failures
from tests.builders.eval_results import result_of

HOSTILE = "m:<script>alert(1)</script>"


def evaluation_of(*names: str) -> Evaluation:
    rows = [result_of(n, success=n % 2 == 0, instruction="<b>Go</b>") for n in range(1, 7)]
    rows += [result_of(n, success=False, variant=Variant.EMPTY, instruction="") for n in range(1, 7)]
    scores = tuple(
        score_policy(
            name, rows, PolicyNote(policy=name, knows="nothing", reads_instruction=True, renderer="", software={})
        )
        for name in names
    )
    return Evaluation(
        run="test-00000000",
        source="a test",
        specs_digest="a" * 64,
        episodes=6,
        success_radius_m=1.0,
        complete=True,
        policies=scores,
        remarks=("one & only",),
    )


def test_names_and_instructions_cannot_become_markup() -> None:
    failed = result_of(1, success=False, instruction="<img src=x onerror=alert(1)>", detail="<i>")
    page = write_page(evaluation_of(HOSTILE), {HOSTILE: [(failed, b"RIFF")]})
    assert "<script>" not in page
    assert "<img src=x" not in page
    assert "one &amp; only" in page


def test_everything_is_within_the_page() -> None:
    page = write_page(evaluation_of("stop"), {"stop": [(result_of(1, success=False), b"RIFF")]})
    sources = re.findall(r'(?:src|href)="([^"]*)"', page)
    assert sources == ["data:image/webp;base64,UklGRg=="]
    assert "url(" not in page


def test_each_policy_stands_in_each_table_with_its_interval() -> None:
    page = write_page(evaluation_of("expert", "stop"), {})
    for title in ("All episodes", "By split", "By scene", "By tier", "By category", "By template", "Other words"):
        table = page.split(f"<h2>{title}</h2>")[1].split("</table>")[0]
        assert table.count("<td>expert</td>") == table.count("<td>stop</td>") >= 1, title
    assert "50.0 <small>19 to 81</small>" in page  # Wilson, 3 of 6


def test_failures_are_chosen_from_every_way_to_end() -> None:
    ends = [EvalEnd.TIMEOUT] * 6 + [EvalEnd.COLLISION] * 2 + [EvalEnd.POLICY_HUNG]
    rows = [result_of(n, success=False, end=end) for n, end in enumerate(ends, 1)] + [result_of(10)]
    assert [row.spec_id[-2:] for row in choose_failures(rows, 5)] == ["01", "02", "07", "08", "09"]
    assert len(choose_failures(rows, 99)) == 9
    assert choose_failures(rows, 0) == []
