"""The world in PyBullet: the robot follows commands and stops at walls, and the motion is deterministic."""

from __future__ import annotations

import gc
import hashlib
import math
import struct
import subprocess
import sys
from collections.abc import Iterable, Iterator
from dataclasses import replace

import numpy as np
import pytest

from schemas.config import RobotConfig
from schemas.errors import WorldError
from schemas.scene import CompiledScene
from tests.builders.scene import Box, box_room, build_scene, room_walls
from workers.geometry.slew import Twist, slew
from workers.physics.bullet import BulletClient
from workers.physics.mesh_lists import MESH_TRIANGLES, MeshLists, mesh_lists
from workers.physics.world import ColliderMesh, World

HZ = 60
ROBOT = RobotConfig()
STOP = Twist(0.0, 0.0)


def open_world(scene: CompiledScene) -> World:
    return World(scene, ColliderMesh.from_scene(scene), ROBOT, HZ)


@pytest.fixture
def room() -> Iterator[World]:
    """A room of 8 x 6 m with a crate, a barrel and a pillar; the robot is in the middle."""
    with open_world(box_room()) as world:
        yield world


def drive(world: World, wanted: Iterable[Twist]) -> None:
    command = STOP
    for twist in wanted:
        command = slew(command, twist, ROBOT, 1 / HZ)
        world.command(*command)
        world.step()


def trajectory_digest(world: World | None = None) -> str:
    """Drives a fixed zigzag that hits the crate, by default in a new world; returns the digest of all poses."""
    rng = np.random.default_rng(7)
    digest = hashlib.sha256()
    with world or open_world(box_room()) as world:
        world.place(0.3, 0.4, 0.2)
        for _ in range(12):
            goal = Twist(float(rng.uniform(0, 1)), float(rng.uniform(-1.5, 1.5)))
            for _ in range(20):
                drive(world, [goal])
                pose = world.pose()
                digest.update(struct.pack("7d", pose.x, pose.y, pose.z, pose.qw, pose.qx, pose.qy, pose.qz))
    return digest.hexdigest()


def test_robot_drives_a_straight_metre(room: World) -> None:
    room.place(-1.0, 0.0, 0.0)
    drive(room, [Twist(0.5, 0.0)] * 126)
    drive(room, [STOP] * 30)
    pose = room.pose()
    assert pose.x == pytest.approx(0.0, abs=0.03)
    assert pose.y == pytest.approx(0.0, abs=0.02)
    assert pose.yaw == pytest.approx(0.0, abs=0.02)


@pytest.mark.parametrize("yaw_rate", [-1.5, 1.5])
def test_robot_follows_the_tightest_turn_of_the_action_grid_without_spinning(yaw_rate: float) -> None:
    walls = build_scene(room_walls((-10.0, -10.0), (10.0, 10.0)))
    with open_world(walls) as world:
        drive(world, [Twist(1.0, yaw_rate)] * 120)
        before = world.pose().yaw
        world.command(1.0, yaw_rate)
        world.step()
        assert world.speed() == pytest.approx(1.0, abs=0.05)
        assert math.remainder(world.pose().yaw - before, 2 * math.pi) * HZ == pytest.approx(yaw_rate, abs=0.1)


def test_robot_turns_at_the_commanded_rate_about_base_link(room: World) -> None:
    drive(room, [Twist(0.0, 1.0)] * 60)
    before = room.pose()
    drive_on = room.pose().yaw
    for _ in range(60):
        room.command(0.0, 1.0)
        room.step()
    after = room.pose()
    assert math.remainder(after.yaw - drive_on, 2 * math.pi) == pytest.approx(1.0, rel=0.02)
    assert math.hypot(after.x - before.x, after.y - before.y) < 0.01


def test_speed_is_that_of_base_link(room: World) -> None:
    room.place(-2.0, 0.0, 0.0)
    drive(room, [Twist(0.8, 0.0)] * 60)
    assert room.speed() == pytest.approx(0.8, rel=0.01)
    room.place(-2.0, 0.0, 0.0)
    drive(room, [Twist(0.0, 1.5)] * 60)
    assert room.speed() < 0.02


def test_robot_comes_to_a_stop(room: World) -> None:
    drive(room, [Twist(0.7, 0.3)] * 40)
    drive(room, [STOP] * 20)
    assert room.speed() < 0.02


def test_robot_stops_with_its_front_at_a_wall_and_does_not_enter_the_wall(room: World) -> None:
    room.place(2.5, 0.0, 0.0)
    assert not room.has_obstacle_contact()
    drive(room, [Twist(1.0, 0.0)] * 240)
    assert room.has_obstacle_contact()
    assert room.pose().x == pytest.approx(4.0 - 0.14, abs=0.003)
    assert room.deepest_penetration() < 0.002


def test_wheels_do_not_reach_beyond_the_footprint() -> None:
    lane = (*room_walls((-3.0, -3.0), (3.0, 3.0)), Box((-1, 0.27, 0), (1, 0.5, 1)), Box((-1, -0.5, 0), (1, -0.27, 1)))
    with open_world(build_scene(lane)) as world:
        world.place(0.0, 0.0, 0.0)
        assert world.deepest_penetration() == 0.0
        drive(world, [Twist(0.5, 0.0)] * 60)
        assert not world.has_obstacle_contact()


def test_the_floor_is_not_an_obstacle(room: World) -> None:
    drive(room, [Twist(0.5, 0.5)] * 30)
    assert not room.has_obstacle_contact()
    assert room.deepest_penetration() == 0.0


@pytest.mark.parametrize("depth", [0.01, 0.05, 0.3])
def test_a_pose_that_overlaps_a_wall_has_a_penetration_depth(room: World, depth: float) -> None:
    room.place(4.0 - 0.14 + depth, 0.0, 0.0)
    assert room.deepest_penetration() > 0.005
    room.place(0.0, 0.0, 0.0)
    assert room.deepest_penetration() == 0.0


def test_place_puts_base_link_on_the_floor_at_rest(room: World) -> None:
    drive(room, [Twist(1.0, 1.0)] * 30)
    room.place(-2.0, 1.0, 2.5)
    pose = room.pose()
    assert (pose.x, pose.y, pose.z) == pytest.approx((-2.0, 1.0, 0.0), abs=1e-4)
    assert pose.yaw == pytest.approx(2.5, abs=1e-5)
    assert room.speed() == 0.0
    drive(room, [STOP] * 3)
    assert math.hypot(room.pose().x + 2.0, room.pose().y - 1.0) < 1e-4


def test_robot_stands_on_a_floor_of_any_height() -> None:
    boxes = [Box((-3, -3, 1.1), (3, 3, 1.2), solid=False), Box((2, -3, 1.2), (2.2, 3, 3.0))]
    with open_world(build_scene(boxes, floor_height_m=1.2)) as world:
        drive(world, [STOP] * 30)
        assert world.pose().z == pytest.approx(1.2, abs=1e-3)


def test_a_steady_drive_is_exactly_level_and_hard_braking_is_not(room: World) -> None:
    room.place(-3.0, 0.0, 0.0)
    drive(room, [Twist(0.7, 0.2)] * 60)
    assert (room.pose().qx, room.pose().qy) == (0.0, 0.0)
    leans = []
    for _ in range(8):
        drive(room, [STOP])
        leans.append(2 * math.hypot(room.pose().qx, room.pose().qy))
    assert 1e-3 < max(leans) < 0.1


def test_two_new_worlds_are_bit_identical() -> None:
    assert trajectory_digest() == trajectory_digest()


@pytest.mark.parametrize("substeps", [4, 3])
def test_a_world_after_others_with_the_same_obstacles_is_bit_identical(substeps: int) -> None:
    scene, robot = box_room(), ROBOT.model_copy(update={"physics_substeps": substeps})
    rng, used = np.random.default_rng(5), ColliderMesh.from_scene(scene)
    for _ in range(4):
        with World(scene, used, robot, HZ) as world:  # it is closed while the robot drives into the wall
            world.place(3.0, float(rng.uniform(-1, 1)), float(rng.uniform(-0.3, 0.3)))
            drive(world, [Twist(1.0, float(rng.uniform(-1.5, 1.5)))] * int(rng.integers(60, 120)))
        fresh = World(scene, ColliderMesh.from_scene(scene), robot, HZ)
        assert trajectory_digest(World(scene, used, robot, HZ)) == trajectory_digest(fresh)


def test_a_world_is_identical_if_a_world_with_another_robot_was_built_before() -> None:
    scene = box_room()
    collider, narrow = ColliderMesh.from_scene(scene), ROBOT.model_copy(update={"track_m": 0.3})
    for robot in (ROBOT, narrow, ROBOT):
        found = trajectory_digest(World(scene, collider, robot, HZ))
        assert found == trajectory_digest(World(scene, ColliderMesh.from_scene(scene), robot, HZ))


def test_a_world_in_another_process_is_bit_identical() -> None:
    code = "from tests.integration.test_world import trajectory_digest as t; print(t())"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == trajectory_digest()
    assert done.stderr == ""


def test_two_open_worlds_do_not_affect_each_other(room: World) -> None:
    drive(room, [Twist(0.5, 0.0)] * 5)
    before = room.pose()
    with open_world(box_room()) as other:
        drive(other, [Twist(1.0, 0.0)] * 20)
    assert room.pose() == before
    drive(room, [Twist(0.5, 0.0)])


def test_large_meshes_are_split_into_pieces_with_the_same_triangles() -> None:
    rng = np.random.default_rng(0)
    vertices = rng.uniform(-1, 1, (500, 3)).astype(np.float32)
    triangles = rng.integers(0, 500, (MESH_TRIANGLES + 7, 3)).astype(np.int32)
    pieces = mesh_lists(vertices, triangles)
    corners = [np.array(piece.vertices)[piece.indices] for piece in pieces]
    assert [len(piece) // 3 for piece in corners] == [MESH_TRIANGLES, 7]
    assert np.array_equal(np.concatenate(corners), vertices[triangles.ravel()])


def test_closed_worlds_leave_no_references_to_mesh_lists() -> None:
    """PyBullet itself would keep a reference to every list that it receives."""
    rng = np.random.default_rng(0)
    vertices = rng.uniform(3, 4, (3000, 3)).astype(np.float32)
    scene = replace(
        box_room(),
        collider_vertices=vertices,
        collider_triangles=rng.integers(0, 3000, (3000, 3)).astype(np.int32),
    )
    counts = []
    for _ in range(6):
        with open_world(scene), BulletClient() as client:
            client.add_visual(vertices, vertices[:, :2], (1.0, 1.0, 1.0))
        gc.collect()
        counts.append(sum(type(each) is list for each in gc.get_objects()))
    assert counts[-1] - counts[2] < 300


def test_a_refused_collider_is_reported_with_its_size() -> None:
    scene = box_room()
    stray = ColliderMesh((MeshLists([[0.0, 0.0, 0.0]] * 131_073, [0, 1, 2]),))
    with pytest.raises(WorldError, match="131073 vertices, 1 triangles"):
        World(scene, stray, ROBOT, HZ)
