"""The predicted drive: turns while driving, respects the limits of the robot and ends on the success circle."""

from __future__ import annotations

import math

import numpy as np
import pytest

from schemas.config import TaskConfig
from schemas.job import Job
from schemas.measure import Goal
from tests.builders.bundle import job_for
from workers.sim.spawn import predict_path

GOAL = Goal((4.0, 0.0), 1.0)


def a_job() -> Job:
    return job_for(task=TaskConfig())


@pytest.mark.parametrize("yaw", [0.0, 0.4, -1.5, 3.1])
def test_the_predicted_drive_ends_on_the_success_circle(yaw: float) -> None:
    job = a_job()
    poses = predict_path((0.0, 0.0, yaw), GOAL, job)
    away = np.hypot(poses[:, 0] - 4.0, poses[:, 1])
    assert away[-1] <= job.task.success_radius_m < away[:-1].min()


def test_the_predicted_drive_straight_ahead_is_a_line() -> None:
    poses = predict_path((0.0, 0.0, 0.0), GOAL, a_job())
    assert np.abs(poses[:, 1:]).max() == 0.0
    assert (np.diff(poses[:, 0]) > 0).all()


def test_a_predicted_drive_that_starts_facing_away_curves_to_the_side_to_which_it_turns() -> None:
    poses = predict_path((0.0, 0.0, 3.0), GOAL, a_job())
    assert poses[:, 0].min() < -0.3
    assert poses[:, 1].max() > 0.3
    assert poses[:, 1].min() > -0.1


def test_the_predicted_drive_respects_the_limits_of_the_robot() -> None:
    job = a_job()
    poses = predict_path((0.0, 0.0, 2.0), GOAL, job)
    speed = np.hypot(np.diff(poses[:, 0]), np.diff(poses[:, 1])) * 20
    turn = np.diff(poses[:, 2]) * 20
    assert speed.max() <= job.robot.max_speed_mps + 1e-6
    assert np.diff(speed).max() * 20 <= job.robot.max_acceleration_mps2 + 1e-5
    assert np.abs(turn).max() <= job.robot.max_yaw_rate_rps + 1e-6


def test_the_prediction_ends_at_the_time_limit_of_the_episode() -> None:
    job = a_job()
    assert (
        len(predict_path((0.0, 0.0, 0.0), Goal((1000.0, 0.0), 1.0), job))
        == job.task.max_steps * 20 // job.task.control_hz + 1
    )


def test_a_prediction_from_inside_the_circle_has_no_motion() -> None:
    assert predict_path((3.5, 0.0, 1.0), GOAL, a_job()).tolist() == [[3.5, 0.0, 1.0]]
    assert math.isfinite(predict_path((4.0, 0.0, 1.0), GOAL, a_job())[0, 2])
