"""Each figure of a survey is a line that says what it means."""

from __future__ import annotations

from dataclasses import replace

from factory.cli.scene.survey import say_survey
from factory.scenes.survey.report import report_survey
from tests.builders.scene import box_room


def test_every_figure_is_told_with_what_it_means() -> None:
    report = replace(report_survey(box_room()), blind=3, unseen=("crate_001",), farthest_floor_m=1.25)
    lines = list(say_survey(report))
    assert "start points without a visible target: 3; only the planner expert uses them" in lines
    assert "targets visible from no start point: crate_001" in lines
    assert any(line.endswith("largest distance of free floor to a start point: 1.25 m") for line in lines)
