"""Each figure of a survey is a line that says what it means."""

from __future__ import annotations

from dataclasses import replace

from factory.cli.scene.survey import say_survey
from factory.scenes.survey.report import report_survey
from tests.builders.scene import box_room


def test_every_figure_is_told_with_what_it_means() -> None:
    report = replace(report_survey(box_room()), blind=3, unseen=("crate_001",), farthest_floor_m=1.25)
    lines = list(say_survey(report))
    assert "spawns without a target in sight: 3; only the planner expert starts there" in lines
    assert "targets in sight of no spawn: crate_001" in lines
    assert any(line.endswith("the spot farthest from all spawns is 1.25 m away") for line in lines)
