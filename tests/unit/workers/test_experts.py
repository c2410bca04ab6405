"""The proportional expert and its speed laws, against the paper's equations."""

from __future__ import annotations

import math

import pytest

from coordinator.builtin_plans import BUILTIN_PLANS
from coordinator.draw import expand, to_job
from coordinator.plan_file import shrink
from schemas.errors import UsageError
from schemas.job import Job
from schemas.terms import ExpertName
from tests.builders.catalog import make_catalog
from workers.experts import Observation, make_expert
from workers.sight import Sighting

UNSEEN = Sighting(0, 320.0, 0.0)


def make_job(expert: ExpertName = ExpertName.PROPORTIONAL) -> Job:
    plan = shrink(BUILTIN_PLANS["demo"], expert=expert)
    catalog = make_catalog(plan)
    return to_job(plan, catalog, expand(plan, catalog)[0], 1)


def seen(distance=3.0, bearing=0.0, sighting=UNSEEN, near=False) -> Observation:
    return Observation(sighting, bearing, distance, near)


def test_speed_is_proportional_to_the_centroid_distance_and_clamped():
    expert = make_expert(make_job())
    assert expert.act(seen(distance=1.2)).v_mps == pytest.approx(0.84)
    assert expert.act(seen(distance=5.0)).v_mps == 1.0


def test_the_robot_is_told_to_stand_inside_the_success_circle():
    expert = make_expert(make_job())
    assert expert.act(seen(distance=1.0, bearing=0.5)) == (0.0, 0.0)


def test_yaw_follows_the_mask_when_visible_and_the_bearing_when_not():
    expert = make_expert(make_job())
    right = Sighting(100, 480.0, 3.0)
    assert expert.act(seen(bearing=1.0, sighting=right)).w_rps == pytest.approx(-0.7)
    assert expert.act(seen(bearing=0.5)).w_rps == pytest.approx(0.7)
    assert expert.act(seen(bearing=math.pi)).w_rps == 1.5


def test_speed_is_capped_but_not_zero_near_an_obstacle():
    assert make_expert(make_job()).act(seen(near=True)).v_mps == pytest.approx(0.1)


def test_the_literal_law_stops_when_the_surface_is_one_radius_away():
    expert = make_expert(make_job(ExpertName.PAPER_LITERAL))
    assert expert.act(seen(distance=1.3, sighting=Sighting(500, 320.0, 1.0))).v_mps == 0.0
    assert expert.act(seen(distance=3.3, sighting=Sighting(500, 320.0, 2.0))).v_mps == pytest.approx(0.7)


def test_the_depth_law_uses_the_mask_depth_while_visible():
    expert = make_expert(make_job(ExpertName.DEPTH))
    assert expert.act(seen(distance=1.3, sighting=Sighting(500, 320.0, 1.0))).v_mps == pytest.approx(0.7)
    assert expert.act(seen(distance=1.3)).v_mps == pytest.approx(0.91)


def test_an_expert_that_this_version_lacks_is_named():
    with pytest.raises(UsageError, match="planner"):
        make_expert(make_job(ExpertName.PLANNER))
