"""The experts: speed laws compared with the paper's equations, and the planner near its goal."""

from __future__ import annotations

import math
from typing import NamedTuple

import pytest

from coordinator.expansion.builtin import BUILTIN_PLANS
from coordinator.expansion.draw import expand, to_job
from coordinator.expansion.plan_file import shrink
from schemas.job import Job
from schemas.terms import ExpertName
from tests.builders.catalog import make_catalog
from tests.builders.scene import box_room
from workers.experts import Expert, make_expert
from workers.experts.observation import MaskMeasures
from workers.geometry.grid import Grid
from workers.geometry.pose import Pose

UNSEEN = MaskMeasures(0, 320.0, lambda: 0.0)


class Seen(NamedTuple):
    """A view with precomputed values."""

    target_mask: MaskMeasures
    bearing_rad: float
    distance_m: float
    obstacle_near: bool
    pose: Pose


def make_job(expert: ExpertName = ExpertName.PROPORTIONAL) -> Job:
    plan = shrink(BUILTIN_PLANS["demo"], expert=expert)
    catalog = make_catalog(plan)
    return to_job(plan, catalog, expand(plan, catalog)[0], 1)


def seen(distance=3.0, bearing=0.0, target_mask=UNSEEN, near=False) -> Seen:
    return Seen(target_mask, bearing, distance, near, Pose.planar(2.5 - distance, 1.3, 0.0))


def test_speed_is_proportional_to_the_centroid_distance_and_clamped():
    expert = make_expert(make_job())
    assert expert.act(seen(distance=1.2)).v_mps == pytest.approx(0.84)
    assert expert.act(seen(distance=5.0)).v_mps == 1.0


def test_the_commanded_speed_is_zero_inside_the_success_circle():
    expert = make_expert(make_job())
    assert expert.act(seen(distance=1.0, bearing=0.5)) == (0.0, 0.0)


def test_yaw_follows_the_mask_when_visible_and_the_bearing_when_not():
    expert = make_expert(make_job())
    right = MaskMeasures(100, 480.0, lambda: 3.0)
    assert expert.act(seen(bearing=1.0, target_mask=right)).w_rps == pytest.approx(-0.7)
    assert expert.act(seen(bearing=0.5)).w_rps == pytest.approx(0.7)
    assert expert.act(seen(bearing=math.pi)).w_rps == 1.5


def test_speed_is_capped_but_not_zero_near_an_obstacle():
    assert make_expert(make_job()).act(seen(near=True)).v_mps == pytest.approx(0.1)


def test_the_paper_literal_expert_stops_when_the_surface_is_one_radius_away():
    expert = make_expert(make_job(ExpertName.PAPER_LITERAL))
    assert expert.act(seen(distance=1.3, target_mask=MaskMeasures(500, 320.0, lambda: 1.0))).v_mps == 0.0
    assert expert.act(seen(distance=3.3, target_mask=MaskMeasures(500, 320.0, lambda: 2.0))).v_mps == pytest.approx(0.7)


def test_the_depth_law_uses_the_mask_depth_while_visible():
    expert = make_expert(make_job(ExpertName.DEPTH))
    assert expert.act(seen(distance=1.3, target_mask=MaskMeasures(500, 320.0, lambda: 1.0))).v_mps == pytest.approx(0.7)
    assert expert.act(seen(distance=1.3)).v_mps == pytest.approx(0.91)


@pytest.mark.parametrize("name", ExpertName)
def test_every_expert_name_can_be_constructed(name):
    assert isinstance(make_expert(make_job(name)), Expert)


def started_planner() -> Expert:
    scene = box_room()
    crate = next(target for target in scene.info.targets if target.category == "crate")
    expert = make_expert(make_job(ExpertName.PLANNER))
    path = expert.begin(Pose.planar(-0.5, 0.5, 0.0), Grid.from_scene(scene), crate)
    assert path
    return expert


def test_the_planner_slows_down_towards_the_goal_as_the_proportional_expert_does():
    assert started_planner().act(seen(distance=1.1)).v_mps <= 0.77 + 1e-9


def test_the_planner_stops_within_the_circle_and_does_not_start_again():
    expert = started_planner()
    assert expert.act(seen(distance=0.98)) != (0.0, 0.0)
    assert expert.act(seen(distance=0.96)) == (0.0, 0.0)
    assert expert.act(seen(distance=0.99)) == (0.0, 0.0)


def test_the_planner_refuses_to_drive_without_a_path():
    with pytest.raises(RuntimeError, match="begin"):
        make_expert(make_job(ExpertName.PLANNER)).act(seen())
