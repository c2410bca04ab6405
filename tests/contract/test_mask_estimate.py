"""Compares the predicted appearance of a target with the rendered mask."""

from __future__ import annotations

import math
from collections.abc import Iterator

import pytest

from schemas.config import CameraConfig
from schemas.job import Job
from schemas.measure import Goal
from tests.builders.bundle import job_for
from tests.builders.scene import Box, build_scene
from workers.experts.observation import measure_mask
from workers.geometry.mask_estimate import MaskEstimate
from workers.geometry.pose import Pose
from workers.render import Renderer
from workers.render.choose import open_renderer
from workers.sim.spawn import predict_path

CAMERA = CameraConfig()
TARGETS = {
    "box": Box((2.0, -0.4, 0.0), (2.6, 0.3, 0.9), category="crate"),
    "long one at an angle": Box((1.0, 1.2, 0.0), (5.0, 1.6, 2.0), category="rack"),
    "one beyond both edges": Box((2.6, -3.0, 0.0), (2.9, 2.5, 1.5), category="rack"),
    "high and far": Box((6.0, -2.5, 1.0), (6.4, 1.0, 3.0), category="shelf"),
}


@pytest.fixture(scope="module")
def renderer() -> Iterator[Renderer]:
    with open_renderer("gl") as opened:
        yield opened


@pytest.mark.gl
@pytest.mark.parametrize("name", TARGETS)
@pytest.mark.parametrize("yaw", [-0.5, 0.0, 0.3, 0.7])
def test_the_predicted_centroid_matches_the_mask(renderer: Renderer, name: str, yaw: float) -> None:
    scene = build_scene([TARGETS[name]])
    renderer.load(scene, CAMERA)
    depth_and_ids = renderer.render_depth_and_ids(Pose.planar(0.1, -0.05, yaw))
    drawn = measure_mask(depth_and_ids.ids, depth_and_ids.depth, 1, min_pixels=1)
    pixels, column = MaskEstimate(scene, 1, CAMERA).evaluate(0.1, -0.05, yaw)
    assert pixels == pytest.approx(drawn.pixels, rel=0.35, abs=50)
    if drawn.pixels > 5000:  # the target is not only a few pixels at the edge of the image
        assert column == pytest.approx((drawn.column - 320) / 320, abs=0.12)


def test_an_object_behind_the_camera_is_not_in_view() -> None:
    assert MaskEstimate(build_scene([TARGETS["box"]]), 1, CAMERA).evaluate(0.0, 0.0, math.pi) == (0.0, 0.0)
    assert MaskEstimate(build_scene([TARGETS["box"]]), 99, CAMERA).evaluate(0.0, 0.0, 0.0) == (0.0, 0.0)


def test_a_long_target_seen_at_an_angle_is_approached_at_its_near_end() -> None:
    job: Job = job_for()
    box = Box((3.0, -2.0, 0.0), (3.5, 2.0, 2.0), category="rack")
    start, goal = (0.0, -3.0, math.atan2(3.0, 3.25)), (3.25, 0.0)
    region = Goal(goal, job.task.success_radius_m)
    straight = predict_path(start, region, job)
    drawn_to = predict_path(start, region, job, MaskEstimate(build_scene([box]), 1, CAMERA))
    assert straight[-1, 1] == pytest.approx(goal[1] - 3.0 / math.hypot(3.25, 3.0) * job.task.success_radius_m, abs=0.05)
    assert drawn_to[-1, 1] < straight[-1, 1] - 0.1
