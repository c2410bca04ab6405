"""Culling: nothing that could be seen is dropped, and the nearest part comes first."""

from __future__ import annotations

from collections.abc import Sequence

from schemas.config import CameraConfig
from tests.builders.scene import Box, build_scene
from workers.geometry.camera import optical_pose, projection_matrix, view_matrix
from workers.geometry.pose import Pose
from workers.render.visible_parts import PartBounds, visible_parts


def cube(x: float, y: float, z: float = 0.3) -> Box:
    return Box((x - 0.1, y - 0.1, z - 0.1), (x + 0.1, y + 0.1, z + 0.1))


def seen(boxes: Sequence[Box]) -> list[int]:
    optical = optical_pose(Pose.planar(0.0, 0.0, 0.0), CameraConfig())
    clip = projection_matrix(CameraConfig()) @ view_matrix(optical)
    return [int(part) for part in visible_parts(PartBounds.of(build_scene(boxes)), clip, optical.eye)]


def test_parts_behind_and_beside_the_view_are_dropped() -> None:
    assert seen([cube(-2, 0), cube(2, 5), cube(2, -5), cube(2, 0, 5.0), cube(2, 0)]) == [4]


def test_parts_beyond_the_clip_range_are_dropped() -> None:
    assert seen([cube(31, 0), cube(29, 0)]) == [1]


def test_a_part_that_reaches_into_the_view_is_kept() -> None:
    assert seen([Box((-5, 1, 0), (5, 1.2, 2))]) == [0]


def test_the_nearest_part_comes_first() -> None:
    assert seen([cube(3, 0), cube(1, 0), cube(2, 0)]) == [1, 2, 0]


def test_a_floor_is_drawn_after_the_objects_on_it() -> None:
    assert seen([Box((-4, -4, -0.1), (4, 4, 0.0)), cube(2, 0), cube(0.5, 0)]) == [2, 1, 0]
