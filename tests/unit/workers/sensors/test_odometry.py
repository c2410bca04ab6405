"""Wheel odometry: ticks of known drives, dead reckoning, and the growth of its error."""

from __future__ import annotations

import math

import numpy as np
import pytest

from schemas.rig.noise import OdometryNoise
from schemas.rig.sensors import WheelOdometry
from workers.sensors import NoiseKey, sense_odometry

HZ = 60
KEY = NoiseKey(1, 2, "odometry")
QUIET = OdometryNoise(slip_std_m=0, radius_error_std=0)


def odometry(**fields: object) -> WheelOdometry:
    return WheelOdometry.model_validate({"name": "odometry", "model": "odometry", **fields})


def constant(speed: float, turn: float, steps: int) -> np.ndarray[tuple[int, int], np.dtype[np.float32]]:
    return np.tile(np.array((speed, turn), np.float32), (steps, 1))


def test_a_straight_drive_of_one_turn_of_the_wheels_counts_the_ticks_of_one_turn() -> None:
    sensor = odometry(ticks_per_turn=1000)
    steps = 121
    speed = 2 * math.pi * sensor.wheel_radius_m / ((steps - 1) / HZ) * (1 + 1e-6)
    found = sense_odometry(sensor, constant(speed, 0, steps), HZ, KEY)
    assert found.ticks[0].tolist() == [0, 0]
    assert found.ticks[-1].tolist() == [1000, 1000]


def test_a_turn_on_the_spot_counts_backwards_on_the_left_wheel() -> None:
    sensor = odometry()
    found = sense_odometry(sensor, constant(0, math.pi / 2, HZ + 1), HZ, KEY)
    left, right = found.ticks[-1]
    arc = math.pi / 2 * sensor.track_m / 2 / (2 * math.pi * sensor.wheel_radius_m) * sensor.ticks_per_turn
    assert (left, right) == (pytest.approx(-arc, abs=1), pytest.approx(arc, abs=1))
    assert found.poses[-1] == pytest.approx((0, 0, math.pi / 2), abs=2e-3)


def test_dead_reckoning_of_a_circle_ends_where_the_circle_ends() -> None:
    speed, turn = 0.5, 0.5
    steps = round(2 * math.pi / turn * HZ) + 1
    found = sense_odometry(odometry(ticks_per_turn=1 << 20), constant(speed, turn, steps), HZ, KEY)
    half = found.poses[steps // 2]
    assert half == pytest.approx((0, 2 * speed / turn, math.pi), abs=0.02)
    assert found.poses[-1] == pytest.approx((0, 0, 2 * math.pi), abs=0.02)
    assert found.twists[5:] == pytest.approx(np.tile((speed, turn), (steps - 5, 1)), abs=0.01)


def test_the_last_command_of_an_episode_is_not_carried_out() -> None:
    twists = constant(0.5, 0.0, 10)
    changed = twists.copy()
    changed[-1] = 1.0
    assert (
        sense_odometry(odometry(), twists, HZ, KEY).ticks == sense_odometry(odometry(), changed, HZ, KEY).ticks
    ).all()


def test_a_prefix_of_an_episode_gives_a_prefix_of_the_measurements() -> None:
    twists = constant(0.6, 0.4, 90)
    sensor = odometry(noise=OdometryNoise(slip_std_m=0.02))
    whole, part = sense_odometry(sensor, twists, HZ, KEY), sense_odometry(sensor, twists[:30], HZ, KEY)
    assert (part.ticks == whole.ticks[:30]).all()
    assert (part.poses == whole.poses[:30]).all()


def test_a_slower_odometry_reads_the_same_ticks_less_often() -> None:
    twists = constant(0.6, 0.4, 91)
    fast, slow = (sense_odometry(odometry(rate_hz=rate), twists, HZ, KEY) for rate in (60, 20))
    assert (slow.ticks == fast.ticks[::3]).all()
    assert slow.twists[5:] == pytest.approx(np.tile((0.6, 0.4), (len(slow.twists) - 5, 1)), abs=0.05)


@pytest.mark.parametrize("control_hz", [30, 120])
def test_slip_after_a_distance_depends_on_the_distance_and_not_on_the_rate(control_hz: int) -> None:
    metres, std = 4.0, 0.03
    sensor = odometry(noise=OdometryNoise(slip_std_m=std, radius_error_std=0), ticks_per_turn=1 << 20)
    twists = constant(1.0, 0.0, round(metres * control_hz) + 1)
    keys = [NoiseKey(1, episode, "odometry") for episode in range(300)]
    ends = np.array([sense_odometry(sensor, twists, control_hz, key).ticks[-1] for key in keys])
    travel = ends * 2 * math.pi * sensor.wheel_radius_m / sensor.ticks_per_turn
    assert travel.mean() == pytest.approx(metres, abs=0.01)
    assert travel.std(axis=0) == pytest.approx(std * math.sqrt(metres), rel=0.15)


def test_radius_errors_scale_the_ticks_of_an_episode_and_differ_between_episodes() -> None:
    sensor = odometry(noise=OdometryNoise(slip_std_m=0, radius_error_std=0.01), ticks_per_turn=1 << 20)
    twists = constant(1.0, 0.0, 61)
    exact = sense_odometry(odometry(ticks_per_turn=1 << 20), twists, HZ, KEY).ticks[-1]
    ends = [sense_odometry(sensor, twists, HZ, NoiseKey(1, each, "odometry")).ticks[-1] for each in range(300)]
    assert (np.array(ends) / exact).std() == pytest.approx(0.01, rel=0.15)


def test_noise_of_zero_changes_no_tick() -> None:
    twists = constant(0.6, 0.4, 90)
    quiet, perfect = (sense_odometry(odometry(noise=noise), twists, HZ, KEY) for noise in (QUIET, None))
    assert (quiet.ticks == perfect.ticks).all()
