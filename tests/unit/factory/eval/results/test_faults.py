"""Reports of policy errors: each kind once, with its first message."""

from __future__ import annotations

import pytest

from factory.eval.models.result import EvalEnd, Variant
from factory.eval.policies.registry import PolicyNote
from factory.eval.results.page import write_page
from factory.eval.results.score import faults_of, score_policy
from factory.eval.results.summary_text import describe_ends, fault_lines
from factory.eval.results.text import print_evaluation
from tests.builders.eval_results import evaluation_of, result_of

NOTE = PolicyNote(policy="m:P", knows="camera and instruction", reads_instruction=True, renderer="", software={})


def test_each_kind_of_failure_is_reported_once_with_its_first_message() -> None:
    rows = [
        result_of(1),
        result_of(2, success=False, end=EvalEnd.POLICY_INVALID, detail="NaN"),
        result_of(3, success=False, end=EvalEnd.POLICY_RAISED, detail="ZeroDivisionError: division by zero (p.py:3)"),
        result_of(4, success=False, end=EvalEnd.POLICY_RAISED, detail="KeyError: 'rgb' (p.py:4)"),
        result_of(5, success=False),
    ]
    assert fault_lines(score_policy("m:P", rows, NOTE)) == [
        "m:P: 2 of 5 episodes ended with policy_raised, first ep_000003: ZeroDivisionError: division by zero (p.py:3)",
        "m:P: 1 of 5 episodes ended with policy_invalid, first ep_000002: NaN",
    ]


def test_policy_failures_under_ablated_instructions_are_reported_and_collisions_are_not() -> None:
    rows = [
        result_of(1, success=False, end=EvalEnd.COLLISION),
        result_of(1, success=False, end=EvalEnd.POLICY_HUNG, variant=Variant.EMPTY, instruction=""),
    ]
    (fault,) = faults_of(rows)
    assert (fault.end, fault.drives, fault.of) == (EvalEnd.POLICY_HUNG, 1, 2)


def test_a_policy_is_reported_as_always_failing_only_when_every_episode_failed() -> None:
    raised = result_of(1, success=False, end=EvalEnd.POLICY_RAISED)
    assert score_policy("m:P", [raised], NOTE).only_failed
    assert not score_policy("m:P", [raised, result_of(2, success=False)], NOTE).only_failed
    assert not score_policy("m:P", [], NOTE).only_failed


def test_the_page_escapes_the_markup_in_a_failure() -> None:
    evaluation = evaluation_of("m:P")
    raised = result_of(1, success=False, end=EvalEnd.POLICY_RAISED, detail="ValueError: <b>")
    scores = score_policy("m:P", [raised], NOTE)
    page = write_page(evaluation.model_copy(update={"policies": (scores,)}), {})
    assert "ValueError: &lt;b&gt;" in page


def test_clipped_actions_are_reported_with_the_likely_unit() -> None:
    rows = [result_of(number, num_steps=100, clipped_actions=90) for number in (1, 2)]
    policy = score_policy("p", rows, NOTE)
    assert policy.overall.clipped == 0.9
    assert "90.0 % of the actions clipped" in describe_ends(policy)
    assert any("90 % of the actions were outside the range of the robot" in line for line in fault_lines(policy))
    assert not fault_lines(score_policy("p", [result_of(1, num_steps=100, clipped_actions=4)], NOTE))


def test_a_policy_that_failed_in_every_episode_has_no_measures(capsys: pytest.CaptureFixture[str]) -> None:
    rows = [result_of(n, success=False, end=EvalEnd.POLICY_RAISED, detail="KeyError") for n in (1, 2)]
    rows += [row.model_copy(update={"variant": Variant.EMPTY, "instruction": ""}) for row in rows]
    scores = score_policy("m:P", rows, NOTE)
    assert scores.only_failed
    assert not scores.ablation
    for score in (scores.overall, *scores.groups):
        assert (score.n, score.policy_failure.count) == (2, 2)
        assert score.success.share is score.spl.mean is score.ne_m.mean is score.clipped is None
    evaluation = evaluation_of("a").model_copy(update={"policies": (scores,)})
    print_evaluation(evaluation)
    text = capsys.readouterr().out
    assert "m:P: not evaluated, because it failed in every episode" in " ".join(text.split())
    assert "0.0 [0, 66]" not in text
    page = write_page(evaluation, {})
    assert "m:P: not evaluated, because it failed in every episode" in page
    assert '<td role="cell" data-label="SR, %">–' in " ".join(page.split()).replace("> –", ">–")
