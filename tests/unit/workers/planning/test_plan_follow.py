"""Pure pursuit on an ideal robot: it stays on the path, turns in the planned direction and never drives backwards."""

from __future__ import annotations

import math

import numpy as np
import pytest

from schemas.config import PlannerConfig, RobotConfig
from workers.geometry.pose import Pose
from workers.geometry.slew import Twist, slew
from workers.planning import Waypoint
from workers.planning.follow import Follower, interpolate, legs_of

ROBOT, CONFIG = RobotConfig(), PlannerConfig()
STRAIGHT = tuple(Waypoint(0.2 * step, 0.0, 0.0) for step in range(11))
CORNER = (
    *STRAIGHT,
    *(Waypoint(2.0, 0.0, math.radians(10 * turn)) for turn in range(1, 10)),
    *(Waypoint(2.0, 0.2 * step, math.pi / 2) for step in range(1, 11)),
)


def follow(path: tuple[Waypoint, ...], start: Pose, steps: int = 600) -> tuple[list[Pose], list[Twist]]:
    """Simulates a robot that follows commands exactly; returns its poses and commands."""
    follower, pose, command = Follower(path, ROBOT, CONFIG), start, Twist(0.0, 0.0)
    poses, commands = [pose], []
    for _ in range(steps):
        if follower.is_done:
            break
        command = slew(command, follower.act(pose, 1.0), ROBOT, 1 / 60)
        yaw = pose.yaw + command.w_rps / 60
        pose = Pose.planar(
            pose.x + command.v_mps / 60 * math.cos(yaw), pose.y + command.v_mps / 60 * math.sin(yaw), yaw
        )
        poses.append(pose)
        commands.append(command)
    return poses, commands


def test_a_path_is_cut_where_it_turns_on_the_spot():
    legs = legs_of(CORNER)
    assert [leg.length_m for leg in legs] == pytest.approx([2.0, 2.0])
    assert [leg.turn_rad for leg in legs] == pytest.approx([0.0, math.pi / 2])


def test_a_straight_path_is_driven_straight_and_fast():
    poses, commands = follow(STRAIGHT, Pose.planar(0, 0, 0))
    assert max(abs(pose.y) for pose in poses) < 1e-6
    assert max(command.v_mps for command in commands) == pytest.approx(1.0)


def test_a_corner_is_not_cut():
    poses, commands = follow(CORNER, Pose.planar(0, 0, 0))
    off = [min(abs(pose.y) if pose.x < 2.0 else 9.0, abs(pose.x - 2.0) if pose.y > 0 else 9.0) for pose in poses[:-1]]
    assert max(value for value in off if value < 9.0) < 0.1
    assert max(pose.x for pose in poses) < 2.1
    assert poses[-1].y == pytest.approx(2.0, abs=0.1)
    assert min(command.v_mps for command in commands) >= 0.0


@pytest.mark.parametrize("way", [1, -1])
def test_a_turn_on_the_spot_has_the_planned_direction(way):
    """The robot turns by 200 degrees, although 160 degrees in the other direction would suffice."""
    turn = [Waypoint(0.0, 0.0, math.radians(way * 10 * step)) for step in range(21)]
    yaw = turn[-1].yaw
    path = (*turn, *(Waypoint(0.2 * k * math.cos(yaw), 0.2 * k * math.sin(yaw), yaw) for k in range(1, 6)))
    _, commands = follow(path, Pose.planar(0, 0, 0))
    assert commands[5].w_rps * way > 0
    assert sum(command.w_rps for command in commands) / 60 == pytest.approx(math.radians(way * 200), abs=0.1)


def test_a_turn_on_the_spot_ends_at_the_planned_heading_before_a_curve():
    """The robot turns by 90 degrees, then drives along an arc to the left; a larger turn on the spot could cause
    contact behind the robot."""
    turn = [Waypoint(0.0, 0.0, math.radians(10 * step)) for step in range(10)]
    arc = [Waypoint(0.6 * math.cos(a) - 0.6, 0.6 * math.sin(a), a + math.pi / 2) for a in (0.3, 0.6, 0.9, 1.2)]
    poses, commands = follow((*turn, *arc), Pose.planar(0, 0, 0))
    standing = [pose.yaw for pose, command in zip(poses, commands, strict=False) if command.v_mps == 0.0]
    assert max(standing) < math.pi / 2 + 0.05


def test_speed_in_curves_respects_the_lateral_acceleration():
    bend = tuple(Waypoint(math.sin(angle), 1 - math.cos(angle), angle) for angle in (0.2 * step for step in range(11)))
    _, commands = follow(bend, Pose.planar(0, 0, 0))
    assert max(abs(command.v_mps * command.w_rps) for command in commands) < 1.3 * CONFIG.lateral_acceleration_mps2


def test_a_speed_limit_is_kept():
    follower = Follower(STRAIGHT, ROBOT, CONFIG)
    assert follower.act(Pose.planar(0, 0, 0), 0.05).v_mps == pytest.approx(0.05)


def test_an_empty_path_needs_no_driving():
    follower = Follower((Waypoint(0.0, 0.0, 0.0),), ROBOT, CONFIG)
    assert follower.is_done
    assert follower.act(Pose.planar(0, 0, 0), 1.0) == (0.0, 0.0)


def test_interpolation_at_one_place_equals_that_of_numpy_bit_for_bit():
    rng = np.random.default_rng(3)
    for count in (2, 3, 40):
        places = np.cumsum(rng.uniform(0.01, 0.3, count))
        values = rng.normal(0.0, 5.0, count)
        beside = rng.uniform(places[0] - 0.2, places[-1] + 0.2, 500)
        for place in (*places.tolist(), *beside.tolist()):
            assert interpolate(place, places.tolist(), values.tolist()) == np.interp(place, places, values)


def test_the_nearest_point_is_searched_at_the_points_of_numpy_linspace():
    (leg,) = legs_of(STRAIGHT)
    for along_m in (0.0, 0.137, 1.55, 1.9999, leg.length_m):
        places = np.linspace(along_m, min(along_m + 0.5, leg.length_m), 26)
        assert [leg.nearest(place, 0.3, along_m) for place in places.tolist()] == places.tolist()
