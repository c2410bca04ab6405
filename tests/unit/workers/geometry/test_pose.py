"""Poses: heading and levelling."""

from __future__ import annotations

import math

import pytest

from workers.geometry.pose import Pose


def leaning(yaw: float, pitch: float) -> Pose:
    """A pose that heads `yaw` and then leans forward by `pitch`, radians."""
    cy, sy, cp, sp = math.cos(yaw / 2), math.sin(yaw / 2), math.cos(pitch / 2), math.sin(pitch / 2)
    return Pose(1.0, 2.0, 0.1, cy * cp, -sy * sp, cy * sp, sy * cp)


@pytest.mark.parametrize("yaw", [-3.0, -1.0, 0.0, 0.5, 3.1])
def test_a_tilt_below_the_limit_is_removed_and_the_rest_is_kept(yaw: float) -> None:
    level = leaning(yaw, 5e-5).levelled(1e-4)
    assert (level.x, level.y, level.z, level.qx, level.qy) == (1.0, 2.0, 0.1, 0.0, 0.0)
    assert math.hypot(level.qw, level.qz) == pytest.approx(1.0, abs=1e-15)
    assert level.yaw == pytest.approx(yaw, abs=1e-8)


def test_a_tilt_above_the_limit_is_kept() -> None:
    pose = leaning(1.0, -1.1e-4)
    assert pose.levelled(1e-4) is pose


def test_a_level_pose_is_unchanged() -> None:
    pose = Pose.planar(1.0, 2.0, 0.7)
    again = pose.levelled(1e-4).levelled(1e-4)
    assert again == pose.levelled(1e-4)
