"""Validation of the route of an episode."""

from __future__ import annotations

import pytest

from coordinator.validation.rollout import route_findings
from schemas.episode import Route
from schemas.terms import ExpertName
from tests.builders.bundle import GOAL_M, RADIUS_M, BundleParts, job_for, parts_for

PATH = tuple((0.2 * step, 0.0, 0.0) for step in range(10))


def planner_parts(**route: object) -> BundleParts:
    parts = parts_for(job_for(expert=ExpertName.PLANNER))
    reach = {"geodesic_m": parts.meta.rollout.spawn_dist_m, "planned": _as_far_as_the_circle()}
    return parts.with_meta(route=Route(**reach | route))


def _as_far_as_the_circle() -> tuple[tuple[float, float, float], ...]:
    last = next(k for k, pose in enumerate(PATH) if abs(pose[0] - GOAL_M[0]) < RADIUS_M)
    return PATH[: last + 1]


def findings(parts: BundleParts) -> list[str]:
    return route_findings(parts.meta, parts.arrays)


def test_a_correct_route_is_accepted():
    assert findings(planner_parts()) == []
    assert findings(parts_for()) == []


def test_a_missing_distance_of_an_unconnected_start_is_accepted():
    assert findings(planner_parts(geodesic_m=None)) == []


def test_a_geodesic_shorter_than_the_straight_line_is_refused():
    far = parts_for().with_meta(target_centroid_m=(9.0, 0.0, 0.5), route=Route(geodesic_m=5.0))
    assert "straight line" in findings(far)[0]


@pytest.mark.parametrize(
    ("planned", "words"),
    [
        ((), "a path of 0 poses"),
        (((1.0, 0.0, 0.0), *PATH[6:]), "from pose 0"),
        ((PATH[0], *PATH[4:]), "step of"),
        (((0.0, 0.0, 0.0), (-0.1, 0.0, 0.0)), "from the target"),
    ],
)
def test_a_false_path_is_refused(planned, words):
    parts = planner_parts(planned=planned)
    if words == "from the target":
        parts = parts.with_meta(target_centroid_m=(9.0, 0.0, 0.5), route=Route(planned=planned))
    assert any(words in finding for finding in findings(parts))


def test_the_path_of_an_expert_other_than_the_planner_is_refused():
    assert "proportional" in findings(parts_for().with_meta(route=Route(planned=PATH)))[0]
