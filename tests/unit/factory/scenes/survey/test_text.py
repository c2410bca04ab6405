"""Each value of a survey is printed on a line with its meaning."""

from __future__ import annotations

from dataclasses import replace

from factory.scenes.survey.spawn_survey import report_survey
from factory.scenes.survey.text import describe_survey
from schemas.terms import SuccessMeasure
from tests.builders.scene import box_room


def test_every_figure_is_printed_with_its_meaning() -> None:
    report = replace(report_survey(box_room()), blind=3, unseen=("crate_001",), farthest_floor_m=1.25)
    lines = list(describe_survey(report))
    users = "used only by the planner, and by other experts if spawn.screening is none or sight"
    assert f"start points without a visible target: 3; {users}" in lines
    assert "targets visible from no start point: crate_001" in lines
    assert lines[-1].endswith("with a free straight path to 1 m from the centroid")
    by_surface = report_survey(box_room(), success=SuccessMeasure.SURFACE)
    assert list(describe_survey(by_surface))[-1].endswith("with a free straight path to 1 m from the footprint")
    assert any(line.endswith("largest distance of free floor to a start point: 1.25 m") for line in lines)
