"""Occlusion by walls: parts completely behind a wall are omitted, visible parts are not."""

from __future__ import annotations

import numpy as np
import pytest

from schemas.config import CameraConfig
from schemas.scene import CompiledScene
from tests.builders.scene import Box, build_scene, room_walls
from workers.geometry.camera import Perspective, optical_pose
from workers.geometry.pose import Pose
from workers.render.tiny import TinyRenderer
from workers.render.visible_parts import Occluders, PartBounds

CAMERA = CameraConfig(y_m=0.0)
WALL = Box((2.0, -1.5, 0.0), (2.2, 1.5, 2.5))
AHEAD = Pose.planar(0.0, 0.0, 0.0)


def hidden_in(scene: CompiledScene, pose: Pose = AHEAD) -> set[int]:
    """Returns the instance ids of the parts that are classified as hidden."""
    bounds = PartBounds.of(scene)
    parts = np.arange(len(scene.part_first))
    hidden = Occluders.of(scene).hidden(bounds, parts, optical_pose(pose, CAMERA), Perspective.of(CAMERA, 640))
    return set(scene.part_instance[hidden].tolist())


@pytest.mark.parametrize(
    ("box", "is_hidden"),
    [
        (Box((3.0, -0.5, 0.0), (3.5, 0.5, 1.0)), True),
        (Box((3.0, -0.5, 0.0), (3.5, 2.5, 1.0)), False),  # extends beyond the end of the wall
        (Box((3.0, -0.5, 0.0), (3.5, 0.5, 4.0)), False),  # extends above the wall
        (Box((1.0, -0.5, 0.0), (1.5, 0.5, 1.0)), False),  # in front of the wall
        (Box((1.9, -0.5, 0.0), (2.1, 0.5, 1.0)), False),  # intersects the wall
        (Box((-2.0, -0.5, 0.0), (-1.5, 0.5, 1.0)), False),  # behind the camera
    ],
)
def test_only_parts_that_are_wholly_behind_a_wall_are_hidden(box: Box, is_hidden: bool) -> None:
    scene = build_scene([WALL, box, Box((5.0, -9.0, 0.0), (5.1, 9.0, 3.0))])
    assert (2 in hidden_in(scene)) == is_hidden
    assert 1 not in hidden_in(scene)


def test_a_wall_hides_nothing_from_a_camera_inside_it_or_closer_than_the_near_plane() -> None:
    scene = build_scene([WALL, Box((3.0, -0.5, 0.0), (3.5, 0.5, 1.0))])
    assert hidden_in(scene, Pose.planar(2.05 - CAMERA.x_m, 0.0, 0.0)) == set()
    assert hidden_in(scene, Pose.planar(1.97 - CAMERA.x_m, 0.0, 0.0)) == set()
    assert hidden_in(scene, Pose.planar(1.8 - CAMERA.x_m, 0.0, 0.0)) == {2}


def test_a_small_wall_is_not_used_as_an_occluder() -> None:
    scene = build_scene([Box((2.0, -0.3, 0.0), (2.2, 0.3, 0.6)), Box((3.0, -0.1, 0.2), (3.1, 0.1, 0.4))])
    assert hidden_in(scene) == set()


def test_hidden_parts_are_invisible_in_a_complete_rendering() -> None:
    """Two rooms, a doorway between them, and clutter in both; TinyRenderer draws every part."""
    rng = np.random.default_rng(3)
    clutter = [
        Box((x, y, z), (x + 0.3, y + 0.3, z + 0.3))
        for x, y, z in zip(rng.uniform(-3.5, 3.2, 40), rng.uniform(-2.5, 2.2, 40), rng.uniform(0, 1.5, 40), strict=True)
    ]
    inner = [Box((-0.1, -3.0, 0.0), (0.1, 0.4, 2.5)), Box((-0.1, 1.4, 0.0), (0.1, 3.0, 2.5))]
    scene = build_scene([*room_walls((-4.0, -3.0), (4.0, 3.0)), *inner, *clutter])
    found = 0
    with TinyRenderer(160) as renderer:
        renderer.load(scene, CAMERA)
        for x, y, yaw in zip(rng.uniform(-3, 3, 12), rng.uniform(-2, 2, 12), rng.uniform(-3, 3, 12), strict=True):
            pose = Pose.planar(float(x), float(y), float(yaw))
            hidden = hidden_in(scene, pose)
            found += len(hidden)
            assert not hidden & set(np.unique(renderer.render(pose).ids).tolist())
    assert found > 50
