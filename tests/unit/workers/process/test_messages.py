"""The pipe between supervisor and simulation."""

from __future__ import annotations

from pathlib import Path

import pytest
from pydantic import ValidationError

from schemas.protocol.messages import MAX_DETAIL_CHARS
from schemas.terms import FailReason
from tests.builders.bundle import job_for
from workers.process.messages import (
    SimulationOrder,
    SimulationReport,
    SimulationReportKind,
    failure,
    read_report,
    to_line,
)


def test_an_order_is_one_line_for_any_instruction():
    order = SimulationOrder(
        job=job_for(instruction="two\nlines"), scene_path=Path("s"), bundle_path=Path("b"), sid="h-1"
    )
    line = to_line(order)
    assert line.count(b"\n") == 1
    assert SimulationOrder.model_validate_json(line) == order


def test_a_report_is_read_back_from_the_pipe():
    report = failure(FailReason.COLLISION, "0.3 m", 7, 1.5)
    assert read_report(to_line(report)) == report


def test_other_output_on_the_pipe_is_ignored():
    assert read_report(b"pybullet build time: Jan 29 2025\n") is None


def test_long_detail_keeps_both_ends():
    detail = failure(FailReason.CRASH, "begin" + "x" * 5000 + "end").detail
    assert len(detail) <= MAX_DETAIL_CHARS
    assert detail.startswith("begin")
    assert detail.endswith("end")


@pytest.mark.parametrize("kind", [SimulationReportKind.SUCCESS, SimulationReportKind.FAILURE])
def test_an_outcome_without_its_required_fields_is_refused(kind):
    with pytest.raises(ValidationError):
        SimulationReport(kind=kind)
