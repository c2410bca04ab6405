"""Exchangeable targets: objects that could all be the target from a start, so only the instruction decides."""

from __future__ import annotations

import math
from collections import Counter

import numpy as np
import pytest
from pydantic import ValidationError

from schemas.config import SpawnConfig
from schemas.exchangeable import candidates_of, exchangeable_targets, may_exchange
from schemas.instruction.start_view import StartView, TargetChoice
from schemas.job import Job
from schemas.scene import Target
from schemas.terms import ExpertName, SuccessMeasure, Tier
from tests.builders.bundle import job_for
from tests.builders.catalog import make_entry

START = (0.0, 0.0, 0.0)


def _target(number: int, distance_m: float, bearing_deg: float, side_m: float = 0.5) -> Target:
    """Returns a square chair whose centre is at a distance and direction from the start."""
    x, y = (distance_m * turn(math.radians(bearing_deg)) for turn in (math.cos, math.sin))
    half = side_m / 2
    return Target(
        target_id=f"chair_{number:03d}",
        category="chair",
        instance_id=number,
        prim_path=f"/World/chair_{number}",
        centroid_m=(x, y, 0.4),
        size_m=(side_m, side_m, 0.8),
        footprint_m=((x - half, y - half), (x + half, y - half), (x + half, y + half), (x - half, y + half)),
    )


LEFT, RIGHT = _target(3, 2.8, 35), _target(5, 2.8, -35)


def _job(tier: Tier = Tier.NEAR, share: float = 0.0) -> Job:
    job = job_for(tier=tier, expert=ExpertName.PLANNER, target_id=LEFT.target_id, spawn=SpawnConfig())
    view = StartView(least_same_category=1, choice=TargetChoice(around=3, among=(3, 5, 7), share=share))
    changes = {
        "spawn": SpawnConfig(heading_noise_rad=0.7),
        "start_view": view,
        "task": job.task.model_copy(update={"success": SuccessMeasure.SURFACE, "success_radius_m": 1.0}),
    }
    return job.model_copy(update=changes)


def _found(*targets: Target, hidden: int = 0, tier: Tier = Tier.NEAR) -> list[int]:
    ids = np.zeros((640, 640), np.uint16)
    for row, each in enumerate(targets):
        ids[row, : 31 if each.instance_id == hidden else 32] = each.instance_id
    return [each.instance_id for each in exchangeable_targets(_job(tier), targets, START, ids)]


def test_objects_at_the_distance_of_the_tier_and_within_the_heading_are_found_in_the_order_of_their_ids():
    assert _found(RIGHT, LEFT) == [3, 5]
    assert _found(RIGHT, LEFT, tier=Tier.MID) == []


@pytest.mark.parametrize(
    "other",
    [
        pytest.param(_target(7, 1.4, 0), id="too near"),
        pytest.param(_target(7, 4.5, 0), id="too far"),
        pytest.param(_target(7, 2.8, -75), id="beside the heading"),
        pytest.param(_target(7, 2.8, 180), id="behind"),
    ],
)
def test_an_object_that_the_tier_excludes_could_not_be_the_target(other):
    assert _found(LEFT, RIGHT, other) == [3, 5]


def test_a_hidden_object_could_not_be_the_target():
    assert _found(LEFT, RIGHT, hidden=5) == [3]


def test_two_objects_with_overlapping_success_regions_could_not_be_the_target():
    close = _target(7, 2.8, -20)
    assert _found(LEFT, RIGHT, close) == [3]
    assert _found(LEFT, RIGHT, close, hidden=7) == [3, 5]
    assert _found(LEFT, close) == [3, 7]


def test_too_few_objects_that_could_be_the_target_are_detected_without_an_image():
    assert may_exchange(_job(), (LEFT, RIGHT), START, 2)
    assert not may_exchange(_job(), (LEFT, RIGHT), START, 3)
    assert not may_exchange(_job(), (LEFT, _target(7, 2.8, 15)), START, 2)
    assert may_exchange(_job(), (LEFT, RIGHT, _target(7, 2.8, -20)), START, 2), "the third may be hidden"


def test_every_object_is_the_target_equally_often():
    shares = np.random.default_rng(0).random(3000)
    drawn = Counter(TargetChoice(around=3, among=(3, 5, 7), share=float(share)).of((3, 5, 7)) for share in shares)
    assert sorted(drawn) == [3, 5, 7]
    assert all(abs(count - 1000) < 100 for count in drawn.values())
    assert TargetChoice(around=3, among=(3,), share=0.999_999_999).of((3,)) == 3
    with pytest.raises(ValidationError):
        TargetChoice(around=3, among=(3,), share=1.0)


def test_the_candidates_are_the_objects_of_the_draw_or_only_the_planned_target():
    info = make_entry("office", [LEFT, RIGHT, _target(9, 3, 0)]).info
    assert candidates_of(_job(), info) == (LEFT, RIGHT)
    assert candidates_of(_job().aimed_at(RIGHT), info) == (RIGHT, LEFT)
    assert candidates_of(_job().model_copy(update={"start_view": None}), info) == (LEFT,)
