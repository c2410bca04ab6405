"""The foreseen drive: it turns while it rolls, keeps to the robot's limits and ends on the success circle."""

from __future__ import annotations

import math

import numpy as np
import pytest

from schemas.config import TaskConfig
from schemas.job import Job
from tests.builders.bundle import job_for
from workers.sim.foresight import predict_path

GOAL = (4.0, 0.0)


def a_job() -> Job:
    return job_for(task=TaskConfig())


@pytest.mark.parametrize("yaw", [0.0, 0.4, -1.5, 3.1])
def test_it_ends_on_the_success_circle(yaw: float) -> None:
    job = a_job()
    poses = predict_path((0.0, 0.0, yaw), GOAL, job)
    away = np.hypot(poses[:, 0] - GOAL[0], poses[:, 1] - GOAL[1])
    assert away[-1] <= job.task.success_radius_m < away[:-1].min()


def test_straight_ahead_it_keeps_to_the_line() -> None:
    poses = predict_path((0.0, 0.0, 0.0), GOAL, a_job())
    assert np.abs(poses[:, 1:]).max() == 0.0
    assert (np.diff(poses[:, 0]) > 0).all()


def test_facing_away_it_swings_wide_to_the_side_it_turns_to() -> None:
    poses = predict_path((0.0, 0.0, 3.0), GOAL, a_job())
    assert poses[:, 0].min() < -0.3
    assert poses[:, 1].max() > 0.3
    assert poses[:, 1].min() > -0.1


def test_it_is_held_to_the_limits_of_the_robot() -> None:
    job = a_job()
    poses = predict_path((0.0, 0.0, 2.0), GOAL, job)
    speed = np.hypot(np.diff(poses[:, 0]), np.diff(poses[:, 1])) * 20
    turn = np.diff(poses[:, 2]) * 20
    assert speed.max() <= job.robot.max_speed_mps + 1e-6
    assert np.diff(speed).max() * 20 <= job.robot.max_acceleration_mps2 + 1e-5
    assert np.abs(turn).max() <= job.robot.max_yaw_rate_rps + 1e-6


def test_it_gives_up_with_the_time_of_the_episode() -> None:
    job = a_job()
    assert len(predict_path((0.0, 0.0, 0.0), (1000.0, 0.0), job)) == job.task.max_steps * 20 // job.task.control_hz + 1


def test_inside_the_circle_there_is_no_way_to_go() -> None:
    assert predict_path((3.5, 0.0, 1.0), GOAL, a_job()).tolist() == [[3.5, 0.0, 1.0]]
    assert math.isfinite(predict_path((4.0, 0.0, 1.0), GOAL, a_job())[0, 2])
