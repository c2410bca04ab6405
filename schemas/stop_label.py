"""Labels of when to stop, from recorded poses: stop where a stop succeeds, drive where it does not.

They agree with the success of an episode and not with the habit of an expert, which drives on until the target is
ahead or its path ends. Demonstrations and corrections have the same labels. Pure functions.

Design: docs/training/corrections.md#when-to-stop.
"""

from __future__ import annotations

import math
from enum import IntEnum

import numpy as np
from numpy.typing import NDArray

from schemas.episode import EpisodeMeta
from schemas.measure import Goal
from schemas.support.geometry import planar_states, yaw_of
from schemas.support.numpy_types import Floats

SURE_M = 0.05
"""Distance of the predicted rest from the edge of the success region below which both answers are right, metres: about
the error of the prediction."""


class StopLabel(IntEnum):
    """Label of a step."""

    DRIVE = 0  # a stop would be outside the success region
    STOP = 1  # a stop succeeds, and the camera faces the target
    EITHER = 2  # both are right: a stop succeeds narrowly, or the camera does not face the target


def stop_labels(meta: EpisodeMeta, poses: Floats) -> NDArray[np.uint8]:
    """Returns the label (T,) of each step, as `StopLabel` numbers them.

    The rest after full braking is predicted from the measured speed v: v^2 / (2 a) ahead.

    Args:
        meta: metadata of the episode: its goal, robot, camera and rate.
        poses: (T, 7) poses of base_link in the world frame.

    Raises:
        WorldError: the task measures to the footprint, and the episode records none.
    """
    job = meta.job
    if job.is_false_premise:  # the goal is to stand at the start
        return np.full(len(poses), StopLabel.STOP, np.uint8)
    goal, yaw = Goal.of_episode(meta), yaw_of(poses)
    speed = np.maximum(planar_states(poses, job.task.control_hz)[:, 3].astype(np.float64), 0.0)
    ahead = speed**2 / (2 * job.robot.max_braking_mps2)
    rest = poses[:, :2] + ahead[:, None] * np.stack([np.cos(yaw), np.sin(yaw)], axis=1)
    left = goal.distances(rest) - goal.radius_m
    to_target = np.asarray(goal.centre_m) - poses[:, :2]
    bearing = np.remainder(np.arctan2(to_target[:, 1], to_target[:, 0]) - yaw + math.pi, 2 * math.pi) - math.pi
    is_sure = (left <= -SURE_M) & (np.abs(bearing) <= math.radians(job.camera.fov_deg) / 2)
    labels = np.where(left > 0, StopLabel.DRIVE, np.where(is_sure, StopLabel.STOP, StopLabel.EITHER))
    return labels.astype(np.uint8)
