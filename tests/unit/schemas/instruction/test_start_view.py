"""Conditions on the image at the start: one function for the worker that draws starts and for the validator."""

from __future__ import annotations

import math

import numpy as np
import pytest

from schemas.config import CameraConfig
from schemas.instruction.start_view import IN_FRONT_RAD, StartView, start_view_findings

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
        (StartView(rivals=(RIVAL,)), (TARGET, OTHER), ""),
        (StartView(rivals=(RIVAL,)), (TARGET, RIVAL), "objects [5] are in view, which the instruction fits as well"),
        (StartView(rivals=(RIVAL,)), (OTHER,), "the target is not in view"),
        (StartView(rivals=(RIVAL,)), (), "the target is not in view"),
        (StartView(alike=(RIVAL,)), (), ""),
        (StartView(alike=(RIVAL,)), (TARGET, RIVAL), ""),
        (StartView(alike=(RIVAL,)), (RIVAL, OTHER), "objects [5] of the target's category are in view, the target"),
        (StartView(within_rad=IN_FRONT_RAD), (TARGET, RIVAL), ""),
        (StartView(within_rad=IN_FRONT_RAD), (RIVAL,), "the target is not in view"),
        (StartView(), (RIVAL,), ""),
        (StartView(alike=(RIVAL, OTHER), least_alike=1), (TARGET, RIVAL), ""),
        (
            StartView(alike=(RIVAL, OTHER), least_alike=2),
            (TARGET, RIVAL),
            "1 other objects of the target's category",
        ),
        (StartView(alike=(RIVAL,), least_alike=1), (RIVAL,), "the target is not in view"),
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
    assert _findings(StartView(rivals=(RIVAL,)), TARGET, pixels=31) == "the target is not in view"
    ids = _image(TARGET)
    ids[7, :31] = RIVAL
    depth = np.ones(ids.shape, np.float32)
    assert start_view_findings(StartView(rivals=(RIVAL,)), TARGET, 0.0, ids, depth, CameraConfig(), 32) == []


@pytest.mark.parametrize("view", [StartView(rivals=(RIVAL,)), StartView(within_rad=0.5)])
def test_the_target_is_required_in_view_where_only_it_may_be_meant(view):
    assert view.shows_target
    assert not StartView(alike=(RIVAL,)).shows_target


@pytest.mark.parametrize(("share", "finding"), [(0.4, ""), (0.6, "the target is the nearest object of its category")])
def test_the_target_is_the_nearest_of_two_only_if_the_drawn_share_is_below_a_half(share, finding):
    ids = _image(TARGET, RIVAL)
    depth = np.where(ids == TARGET, 1.0, 2.0).astype(np.float32)
    view = StartView(alike=(RIVAL,), least_alike=1, ranks=(share, 0.0))
    found = start_view_findings(view, TARGET, 0.0, ids, depth, CameraConfig(), 32)
    assert "; ".join(found).startswith(finding)
    assert bool(found) == bool(finding)
