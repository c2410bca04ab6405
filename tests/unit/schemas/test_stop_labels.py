"""Labels of when to stop: they agree with the success of a stop, and not with the habit of an expert."""

from __future__ import annotations

import math

import numpy as np
import pytest
from numpy.typing import NDArray

from schemas.measure import SURE_M, StopLabel, stop_labels
from schemas.terms import Split
from tests.builders.bundle import parts_for

META = parts_for().sealed()
HZ = META.job.task.control_hz
X, Y = META.target_centroid_m[:2]
RADIUS = META.job.task.success_radius_m


def at(distance_m: float, bearing_rad: float = 0.0, speed_mps: float = 0.0) -> NDArray[np.float64]:
    """Returns two poses west of the target; in the second, the robot has a distance, a bearing and a speed."""
    yaw = -bearing_rad
    x = X - distance_m
    before = (x - speed_mps / HZ * math.cos(yaw), Y - speed_mps / HZ * math.sin(yaw))
    turn = (math.cos(yaw / 2), 0.0, 0.0, math.sin(yaw / 2))
    return np.array([(*before, 0.0, *turn), (x, Y, 0.0, *turn)])


@pytest.mark.parametrize(
    ("poses", "label"),
    [
        (at(RADIUS + 0.02), StopLabel.DRIVE),
        (at(RADIUS - SURE_M / 2), StopLabel.EITHER),
        (at(RADIUS - SURE_M - 0.01), StopLabel.STOP),
        (at(0.2, bearing_rad=0.7), StopLabel.STOP),
        (at(0.2, bearing_rad=0.9), StopLabel.EITHER),
        (at(RADIUS + 0.02, speed_mps=1.0), StopLabel.EITHER),
        (at(RADIUS + 0.004, speed_mps=1.0), StopLabel.STOP),
    ],
)
def test_a_stop_is_the_label_where_a_stop_succeeds(poses: NDArray[np.float64], label: StopLabel) -> None:
    assert stop_labels(META, poses)[1] == label


def test_the_goal_of_a_false_premise_is_to_stand() -> None:
    job = META.job.model_copy(update={"split": Split.TEST_FALSE_PREMISE})
    meta = META.model_copy(update={"job": job})
    assert (stop_labels(meta, at(5.0)) == StopLabel.STOP).all()
