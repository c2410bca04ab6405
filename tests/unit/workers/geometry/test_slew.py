"""The slew limit of commands."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from schemas.config import RobotConfig
from workers.geometry.slew import Twist, slew

ROUNDING = 1e-7  # rounding error of float32 for speeds of this size
ROBOT = RobotConfig()
DT = 1 / 60
SPEEDS = st.floats(-1.0, 1.0)
RATES = st.floats(-1.5, 1.5)


def rounded(twist: Twist) -> Twist:
    """Returns the twist rounded to float32, as in the archive."""
    return Twist(float(np.float32(twist.v_mps)), float(np.float32(twist.w_rps)))


def test_acceleration_is_limited() -> None:
    assert slew(Twist(0.2, 0.0), Twist(1.0, 0.0), ROBOT, DT).v_mps == pytest.approx(0.2 + 2.5 * DT)


def test_deceleration_is_limited() -> None:
    assert slew(Twist(0.7, 0.0), Twist(0.0, 0.0), ROBOT, DT).v_mps == pytest.approx(0.7 - 8.0 * DT)


def test_yaw_acceleration_is_limited_in_both_directions() -> None:
    assert slew(Twist(0.0, 0.0), Twist(0.0, 1.5), ROBOT, DT).w_rps == pytest.approx(3.2 * DT)
    assert slew(Twist(0.0, 0.0), Twist(0.0, -1.5), ROBOT, DT).w_rps == pytest.approx(-3.2 * DT)


def test_a_small_change_is_not_limited() -> None:
    assert slew(Twist(0.5, 0.1), Twist(0.51, 0.12), ROBOT, DT) == rounded(Twist(0.51, 0.12))


def test_a_stop_ends_at_exactly_zero() -> None:
    assert slew(Twist(0.05, 0.01), Twist(0.0, 0.0), ROBOT, DT) == Twist(0.0, 0.0)


def test_a_reversal_brakes_to_a_stop_before_it_accelerates_backwards() -> None:
    assert slew(Twist(0.1, 0.0), Twist(-1.0, 0.0), ROBOT, DT).v_mps == 0.0
    assert slew(Twist(0.0, 0.0), Twist(-1.0, 0.0), ROBOT, DT).v_mps == pytest.approx(-2.5 * DT)


def test_reversing_robots_brake_with_the_braking_limit() -> None:
    assert slew(Twist(-0.7, 0.0), Twist(0.0, 0.0), ROBOT, DT).v_mps == pytest.approx(-0.7 + 8.0 * DT)


@given(v=SPEEDS, w=RATES, wanted_v=SPEEDS, wanted_w=RATES)
def test_repeated_slewing_reaches_the_commanded_twist(v: float, w: float, wanted_v: float, wanted_w: float) -> None:
    twist, wanted = Twist(v, w), Twist(wanted_v, wanted_w)
    for _ in range(120):
        twist = slew(twist, wanted, ROBOT, DT)
    assert twist == rounded(wanted)


@given(v=SPEEDS, w=RATES, wanted_v=SPEEDS, wanted_w=RATES)
def test_slewing_towards_a_recorded_twist_returns_it_exactly(
    v: float, w: float, wanted_v: float, wanted_w: float
) -> None:
    before = rounded(Twist(v, w))
    recorded = slew(before, Twist(wanted_v, wanted_w), ROBOT, DT)
    assert rounded(recorded) == recorded
    assert slew(before, recorded, ROBOT, DT) == recorded


@given(v=SPEEDS, w=RATES, wanted_v=SPEEDS, wanted_w=RATES)
def test_no_step_is_larger_than_the_largest_limit(v: float, w: float, wanted_v: float, wanted_w: float) -> None:
    after = slew(Twist(v, w), Twist(wanted_v, wanted_w), ROBOT, DT)
    assert abs(after.v_mps - v) <= 8.0 * DT + ROUNDING
    assert abs(after.w_rps - w) <= 3.2 * DT + ROUNDING
