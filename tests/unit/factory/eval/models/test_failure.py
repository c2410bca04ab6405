"""The kind of a failure follows from the end of the episode and the last second of its track."""

from __future__ import annotations

from typing import Any

import pytest

from factory.eval.models.result import EpisodeResult, EvalEnd, FailureKind
from tests.builders.eval_results import result_of

_STILL = ((0.0, 0.0, 0.0),) * 20
_DRIVING = tuple((0.05 * row, 0.0, 0.0) for row in range(20))


@pytest.mark.parametrize(
    ("changes", "kind"),
    [
        ({"end": EvalEnd.COLLISION, "any_instance": True}, FailureKind.COLLISION),
        ({"end": EvalEnd.POLICY_HUNG}, FailureKind.POLICY),
        ({}, FailureKind.TIMEOUT),
        ({"any_instance": True, "target_in_view": False}, FailureKind.OTHER_INSTANCE),
        ({"target_in_view": False, "track": _STILL}, FailureKind.LOST_TARGET),
        ({"target_in_view": True, "track": _DRIVING}, FailureKind.STEP_LIMIT),
        ({"target_in_view": True, "track": _DRIVING[-1:] * 12}, FailureKind.STOPPED_EARLY),
        ({"target_in_view": True, "track": _STILL}, FailureKind.STOPPED_EARLY),
    ],
)
def test_a_failure_has_a_kind(changes: dict[str, Any], kind: FailureKind) -> None:
    assert result_of(success=False, **changes).failure is kind


def test_a_success_has_none() -> None:
    assert result_of().failure is None


def test_a_result_of_an_older_version_is_read_and_written_as_it_was() -> None:
    text = result_of(success=False).model_dump_json()
    assert "target_in_view" not in text
    assert "attention" not in text
    assert EpisodeResult.model_validate_json(text).model_dump_json() == text
