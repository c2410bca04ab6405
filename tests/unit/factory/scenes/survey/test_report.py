"""The start points of a scene are measured, and too few of them are reported with a reason."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from factory.scenes.inspection import describe_scene
from factory.scenes.survey.spawn_survey import report_survey
from schemas.terms import SuccessMeasure
from tests.builders.scene import Box, box_room, build_scene, room_walls

ROOM = box_room()


def test_a_room_is_measured_by_its_spawns() -> None:
    report = report_survey(ROOM)
    assert report.spawns == len(ROOM.spawns) == len(report.sights)
    assert report.nearest_min_m == report.nearest_median_m == pytest.approx(0.5)
    assert report.share_within == 1.0
    assert report.farthest_floor_m < 0.6


def test_the_covered_share_rises_with_the_requested_distance() -> None:
    shares = [report_survey(ROOM, within).share_within for within in (0.1, 0.25, 1.0)]
    assert shares == sorted(shares)
    assert shares[0] < 0.5


def test_each_spawn_lists_its_visible_targets() -> None:
    report = report_survey(ROOM)
    assert [sight.targets for sight in report.sights] == ROOM.spawn_sees.sum(axis=1).tolist()
    assert {name for sight in report.sights for name in sight.categories} == {"crate", "barrel"}
    assert report.unseen == ()


def test_a_large_object_is_visible_by_its_footprint_and_not_by_its_centroid() -> None:
    table = Box((-1.5, 0.6, 0.0), (1.5, 2.4, 0.5), category="table")
    room = build_scene((*room_walls((-4.0, -3.0), (4.0, 3.0)), table))
    by_centroid, by_surface = (report_survey(room, success=measure) for measure in SuccessMeasure)
    assert by_centroid.unseen == ("table_6",)
    assert by_surface.unseen == ()
    assert by_surface.blind < by_centroid.blind == len(room.spawns)
    assert {name for sight in by_surface.sights for name in sight.categories} == {"table"}


def test_too_few_spawns_are_a_shortcoming_with_a_remedy() -> None:
    few = replace(ROOM, spawns=ROOM.spawns[:3], spawn_sees=ROOM.spawn_sees[:3])
    (reason, *_) = report_survey(few).shortcomings
    assert "3 of 40 recommended spawn points" in reason
    assert "0.72 m" in reason


def test_a_scene_without_spawns_is_measured() -> None:
    none = replace(ROOM, spawns=ROOM.spawns[:0], spawn_sees=ROOM.spawn_sees[:0])
    report = report_survey(none)
    assert (report.spawns, report.share_within, report.nearest_min_m) == (0, 0.0, 0.0)
    assert report.unseen == tuple(target.target_id for target in ROOM.info.targets)


def test_spawns_without_visible_targets_are_a_shortcoming() -> None:
    far_by_surface = replace(ROOM, spawn_sees=np.zeros_like(ROOM.spawn_sees))
    assert report_survey(far_by_surface).shortcomings == report_survey(ROOM).shortcomings
    targets = tuple(target.model_copy(update={"surface_straight_tiers": ()}) for target in ROOM.info.targets)
    blind = replace(far_by_surface, info=ROOM.info.model_copy(update={"targets": targets}))
    assert any("straight path" in reason for reason in report_survey(blind).shortcomings)


def test_a_description_holds_extents_categories_and_targets() -> None:
    facts = describe_scene(ROOM)
    assert facts["extents_m"] == [8.4, 6.4, 2.6]
    assert facts["categories"] == {"barrel": 1, "crate": 1}
    assert {target["id"] for target in facts["targets"]} == {target.target_id for target in ROOM.info.targets}
