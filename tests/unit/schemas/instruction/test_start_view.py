"""Conditions on the image at the start: one function for the worker that draws starts and for the validator."""

from __future__ import annotations

import math

import numpy as np
import pytest

from schemas.config import CameraConfig
from schemas.instruction.start_view import IN_FRONT_RAD, StartView, start_view_findings
from tests.builders.bundle import job_for

TARGET, RIVAL, OTHER = 3, 5, 9


def _image(*shown: int, pixels: int = 32) -> np.ndarray:
    ids = np.zeros((640, 640), np.uint16)
    for row, each in enumerate(shown):
        ids[row, :pixels] = each
    return ids


def _findings(view: StartView, *shown: int, bearing_deg: float = 0.0, pixels: int = 32) -> str:
    ids = _image(*shown, pixels=pixels)
    depth = np.ones(ids.shape, np.float32)
    return "; ".join(start_view_findings(view, TARGET, math.radians(bearing_deg), ids, depth, CameraConfig(), 32))


@pytest.mark.parametrize(
    ("view", "shown", "finding"),
    [
        (StartView(other_referents=(RIVAL,)), (TARGET, OTHER), ""),
        (
            StartView(other_referents=(RIVAL,)),
            (TARGET, RIVAL),
            "objects [5] are in view, and the instruction fits them as well",
        ),
        (StartView(other_referents=(RIVAL,)), (OTHER,), "the target is not in view"),
        (StartView(other_referents=(RIVAL,)), (), "the target is not in view"),
        (StartView(same_category=(RIVAL,)), (), ""),
        (StartView(same_category=(RIVAL,)), (TARGET, RIVAL), ""),
        (
            StartView(same_category=(RIVAL,)),
            (RIVAL, OTHER),
            "objects [5] of the target's category are in view, but not the target",
        ),
        (StartView(within_rad=IN_FRONT_RAD), (TARGET, RIVAL), ""),
        (StartView(within_rad=IN_FRONT_RAD), (RIVAL,), "the target is not in view"),
        (StartView(), (RIVAL,), ""),
        (StartView(same_category=(RIVAL, OTHER), least_same_category=1), (TARGET, RIVAL), ""),
        (
            StartView(same_category=(RIVAL, OTHER), least_same_category=2),
            (TARGET, RIVAL),
            "1 other objects of the target's category",
        ),
        (StartView(same_category=(RIVAL,), least_same_category=1), (RIVAL,), "the target is not in view"),
    ],
)
def test_a_start_meets_its_conditions_or_the_object_that_violates_them_is_named(view, shown, finding):
    found = _findings(view, *shown)
    assert finding in found
    assert bool(found) == bool(finding)


@pytest.mark.parametrize(
    ("bearing_deg", "is_in_front"), [(0, True), (29.9, True), (-29.9, True), (31, False), (-90, False)]
)
def test_in_front_is_within_thirty_degrees_to_either_side(bearing_deg, is_in_front):
    found = _findings(StartView(within_rad=IN_FRONT_RAD), TARGET, bearing_deg=bearing_deg)
    assert (found == "") == is_in_front
    assert is_in_front or found == f"the target is {abs(bearing_deg):.1f} degrees from the heading, above 30"


def test_an_object_with_too_few_pixels_is_not_in_view():
    assert _findings(StartView(other_referents=(RIVAL,)), TARGET, pixels=31) == "the target is not in view"
    ids = _image(TARGET)
    ids[7, :31] = RIVAL
    depth = np.ones(ids.shape, np.float32)
    assert start_view_findings(StartView(other_referents=(RIVAL,)), TARGET, 0.0, ids, depth, CameraConfig(), 32) == []


@pytest.mark.parametrize("view", [StartView(other_referents=(RIVAL,)), StartView(within_rad=0.5)])
def test_the_target_must_be_in_view_if_other_referents_are_excluded_or_its_direction_is_limited(view):
    assert view.shows_target
    assert not StartView(same_category=(RIVAL,)).shows_target


@pytest.mark.parametrize(("share", "finding"), [(0.4, ""), (0.6, "the target is the nearest object of its category")])
def test_with_two_objects_the_target_may_be_the_nearest_only_if_the_drawn_share_is_below_a_half(share, finding):
    ids = _image(TARGET, RIVAL)
    depth = np.where(ids == TARGET, 1.0, 2.0).astype(np.float32)
    view = StartView(same_category=(RIVAL,), least_same_category=1, ranks=(share, 0.0))
    found = start_view_findings(view, TARGET, 0.0, ids, depth, CameraConfig(), 32)
    assert "; ".join(found).startswith(finding)
    assert bool(found) == bool(finding)


def test_json_keeps_the_published_names_of_the_fields():
    view = StartView(other_referents=(RIVAL,), same_category=(RIVAL, OTHER), least_same_category=1)
    text = view.model_dump_json()
    assert text == '{"within_rad":null,"rivals":[5],"alike":[5,9],"least_alike":1}'
    assert StartView.model_validate_json(text) == view
    assert job_for(start_view=view).model_dump()["start_view"]["alike"] == (RIVAL, OTHER)
