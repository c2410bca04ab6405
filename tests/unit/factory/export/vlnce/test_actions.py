"""Discrete actions that follow a driven path, executed by a point that moves exactly."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from factory.export.vlnce.actions import FORWARD, LEFT, RIGHT, STEP_M, STOP, discrete_actions
from tests.builders.discrete_agent import execute

HZ = 60
RADIUS_M = 1.0
MOTIONS = st.lists(st.tuples(st.floats(0.0, 1.0), st.floats(-1.5, 1.5), st.integers(10, 120)), min_size=1, max_size=8)
"""Speed (m/s), angular speed (rad/s) and number of steps of the parts of a drive."""


def driven(*states: tuple[float, float, float]) -> np.ndarray:
    """Returns poses of x, y (metres) and yaw (radians)."""
    return np.array([(x, y, 0.0, math.cos(yaw / 2), 0.0, 0.0, math.sin(yaw / 2)) for x, y, yaw in states])


def drive(motions: list[tuple[float, float, int]]) -> np.ndarray:
    x, y, yaw = 1.0, -2.0, 0.4
    states = [(x, y, yaw)]
    for v, w, steps in motions:
        for _ in range(steps):
            yaw += w / HZ
            x, y = x + v / HZ * math.cos(yaw), y + v / HZ * math.sin(yaw)
            states.append((x, y, yaw))
    return driven(*states)


@given(MOTIONS, st.floats(0.0, RADIUS_M), st.floats(-math.pi, math.pi))
def test_the_agent_follows_the_path_and_ends_in_the_success_region(motions, distance_m, bearing):
    poses = drive(motions)
    end = poses[-1, :2]
    goal = (end[0] + distance_m * math.cos(bearing), end[1] + distance_m * math.sin(bearing))
    actions = discrete_actions(poses, [goal], RADIUS_M)
    assert actions.index(STOP) == len(actions) - 1
    track, yaw = execute(actions, poses[0, :2], 2 * math.atan2(poses[0, 6], poses[0, 3]))
    assert math.dist(track[-1], goal) <= RADIUS_M
    off = np.linalg.norm(track[:, None] - poses[None, :, :2], axis=2)
    assert off.min(axis=1).max() <= 0.4, "the agent stays near the path"
    assert off.min(axis=0).max() <= 0.5, "the agent leaves no part out"
    turned = math.remainder(yaw - 2 * math.atan2(poses[-1, 6], poses[-1, 3]), 2 * math.pi)
    assert abs(turned) <= math.radians(7.5) + 1e-9


def test_a_straight_drive_is_forward_steps():
    poses = driven(*((n / 60, 0.0, 0.0) for n in range(61)))
    assert discrete_actions(poses, [(1.5, 0.0)], RADIUS_M) == [FORWARD] * 4 + [STOP]


@pytest.mark.parametrize(("sign", "action"), [(1, LEFT), (-1, RIGHT)])
def test_a_turn_on_the_spot_has_its_direction(sign, action):
    poses = driven(*((0.0, 0.0, sign * math.radians(n)) for n in range(46)))
    assert discrete_actions(poses, [(0.5, 0.0)], RADIUS_M) == [action] * 3 + [STOP]


def test_a_drive_that_ends_at_the_border_of_the_success_region_ends_with_a_step_towards_the_goal():
    poses = driven(*((n * 0.01, 0.0, 0.0) for n in range(36)))  # 0.35 m: one step ends 0.1 m before the last pose
    assert discrete_actions(poses, [(0.35 + 0.5, 0.0)], RADIUS_M) == [FORWARD, STOP]
    assert discrete_actions(poses, [(0.35 + RADIUS_M, 0.0)], RADIUS_M) == [FORWARD, FORWARD, STOP]


def test_a_robot_that_does_not_move_stops():
    assert discrete_actions(driven((0, 0, 0), (0, 0, 0)), [(0.5, 0.0)], RADIUS_M) == [STOP]


def test_a_step_is_that_of_vln_ce():
    track, yaw = execute([FORWARD, LEFT, LEFT, LEFT, LEFT, LEFT, LEFT, FORWARD, RIGHT], (0.0, 0.0), 0.0)
    np.testing.assert_allclose(track[-1], (STEP_M, STEP_M), atol=1e-12)
    assert math.degrees(yaw) == pytest.approx(75.0)
