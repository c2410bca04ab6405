"""The IMU: exact motions have known measurements, and its noise has known statistics."""

from __future__ import annotations

import math

import numpy as np
import pytest
from numpy.typing import NDArray

from schemas.rig.noise import ImuNoise
from schemas.rig.sensors import Imu, Mount
from workers.sensors import NoiseKey, sense_imu
from workers.sensors.frames import mount_rotation, rotations, sensor_poses
from workers.sensors.imu import GRAVITY_MPS2, imu_errors

Floats = NDArray[np.float64]
HZ = 60
KEY = NoiseKey(1, 2, "imu")
OFF_CENTRE = Mount(x_m=-0.3, y_m=0.1, z_m=0.2)


def imu(mount: Mount = OFF_CENTRE, **fields: object) -> Imu:
    return Imu.model_validate({"name": "imu", "model": "imu", "mount": mount, **fields})


def planar(x: Floats, y: Floats, yaw: Floats) -> Floats:
    zero = np.zeros_like(yaw)
    return np.column_stack((x, y, zero, np.cos(yaw / 2), zero, zero, np.sin(yaw / 2)))


def circle(speed: float, turn: float, steps: int = 200) -> Floats:
    """A circle about (0, radius) that begins at full speed."""
    yaw = turn * np.arange(steps) / HZ
    return planar(speed / turn * np.sin(yaw), speed / turn * (1 - np.cos(yaw)), yaw)


def wandering(steps: int = 120) -> Floats:
    """A path with tilts, in all six degrees of freedom, that begins at rest."""
    rng = np.random.default_rng(4)
    walk = np.cumsum(np.cumsum(rng.normal(size=(steps, 7)) * 1e-4, axis=0), axis=0)
    walk -= walk[0]
    walk[:, 3] += 1
    walk[:, 3:] /= np.linalg.norm(walk[:, 3:], axis=1, keepdims=True)
    return walk


def test_a_level_imu_at_rest_measures_gravity_upwards_and_no_rotation() -> None:
    found = sense_imu(imu(), planar(np.ones(5), np.ones(5), np.full(5, 0.7)), HZ, KEY)
    assert found.specific_force == pytest.approx(np.tile((0, 0, GRAVITY_MPS2), (5, 1)), abs=1e-6)
    assert not found.angular_velocity.any()


def test_a_tilted_imu_at_rest_measures_gravity_in_its_own_axes() -> None:
    mount = Mount(z_m=0.2, roll_deg=90)  # y of the sensor points up
    found = sense_imu(imu(mount), planar(np.zeros(3), np.zeros(3), np.zeros(3)), HZ, KEY)
    assert found.specific_force[-1] == pytest.approx((0, GRAVITY_MPS2, 0), abs=1e-6)


def test_circular_motion_gives_yaw_rate_and_centripetal_acceleration_of_the_lever_arm() -> None:
    speed, turn = 0.8, 1.2
    found = sense_imu(imu(), circle(speed, turn), HZ, KEY)
    assert found.angular_velocity[5:] == pytest.approx(np.tile((0, 0, turn), (195, 1)), abs=1e-6)
    inwards = np.array((-OFF_CENTRE.x_m, speed / turn - OFF_CENTRE.y_m)) * turn**2
    assert found.specific_force[5:, :2] == pytest.approx(np.tile(inwards, (195, 1)), rel=2e-4)
    assert found.specific_force[5:, 2] == pytest.approx(GRAVITY_MPS2, abs=1e-6)


def test_integrated_measurements_give_the_trajectory_back() -> None:
    poses = wandering()
    mount = Mount(x_m=0.2, y_m=-0.1, z_m=0.3, roll_deg=20, pitch_deg=-30, yaw_deg=50)
    found = sense_imu(imu(mount), poses, HZ, KEY)
    positions, frames = sensor_poses(poses, mount)
    velocity, place, turn = np.zeros(3), positions[0].copy(), frames[0]
    for step in range(len(poses)):
        before = frames[max(step - 1, 0)]
        velocity = velocity + (before @ found.specific_force[step] - (0, 0, GRAVITY_MPS2)) / HZ
        place = place + velocity / HZ
        turn = turn @ rotation_of(found.angular_velocity[step] / HZ)
        assert place == pytest.approx(positions[step], abs=1e-5)
        assert turn == pytest.approx(frames[step], abs=1e-5)


def rotation_of(vector: Floats) -> Floats:
    angle = float(np.linalg.norm(vector))
    axis = vector / max(angle, 1e-12)
    return rotations(np.array([[math.cos(angle / 2), *(math.sin(angle / 2) * axis)]]))[0]


def test_a_prefix_of_an_episode_gives_a_prefix_of_the_measurements() -> None:
    poses, sensor = wandering(), imu(noise=ImuNoise())
    whole, part = sense_imu(sensor, poses, HZ, KEY), sense_imu(sensor, poses[:40], HZ, KEY)
    assert (part.specific_force == whole.specific_force[:40]).all()
    assert (part.angular_velocity == whole.angular_velocity[:40]).all()


def test_a_slower_imu_measures_the_mean_over_its_period() -> None:
    found = sense_imu(imu(rate_hz=20), circle(0.5, 1.0, 31), HZ, KEY)
    assert len(found.angular_velocity) == 11
    assert found.angular_velocity[1:, 2] == pytest.approx(1.0, abs=1e-6)


def test_measurements_are_limited_to_the_range_of_the_sensor() -> None:
    sensor = imu(gyro_range_rps=0.5, accelerometer_range_mps2=5.0)
    found = sense_imu(sensor, circle(0.8, 1.2), HZ, KEY)
    assert found.angular_velocity.max() == 0.5
    assert found.specific_force.max() == 5.0


def test_a_mounting_rotates_about_the_fixed_axes_x_y_and_z_in_this_order() -> None:
    turn = mount_rotation(Mount(roll_deg=90, yaw_deg=90))
    assert turn @ (0, 0, 1) == pytest.approx((1, 0, 0), abs=1e-12)  # roll turns z to -y, yaw turns -y to x


# Noise ------------------------------------------------------------------------------------------------------------


def allan_deviation(values: Floats, cluster: int) -> Floats:
    """Returns the Allan deviation of each column of (N, K) values, for clusters of `cluster` values."""
    means = values[: len(values) // cluster * cluster].reshape(-1, cluster, values.shape[1]).mean(axis=1)
    return np.asarray(np.sqrt((np.diff(means, axis=0) ** 2).mean(axis=0) / 2))


def test_white_noise_has_the_given_density_and_its_allan_deviation_falls_with_the_square_root_of_time() -> None:
    noise = ImuNoise(gyro_white=1e-3, gyro_walk=0, accelerometer_white=2e-2, accelerometer_walk=0)
    errors = imu_errors(noise, 100_000, HZ, KEY)
    densities = np.repeat((1e-3, 2e-2), 3)
    assert errors.std(axis=0) == pytest.approx(densities * math.sqrt(HZ), rel=0.02)
    for seconds in (0.5, 2, 8):
        found = allan_deviation(errors, round(seconds * HZ))
        assert found == pytest.approx(densities / math.sqrt(seconds), rel=0.1)


def test_the_allan_deviation_of_a_random_walk_grows_with_the_square_root_of_time() -> None:
    noise = ImuNoise(gyro_white=0, gyro_walk=3e-3, accelerometer_white=0, accelerometer_walk=4e-2)
    errors = imu_errors(noise, 200_000, HZ, KEY)
    walks = np.repeat((3e-3, 4e-2), 3)
    for seconds in (1, 4, 16):
        found = allan_deviation(errors, seconds * HZ)
        assert found == pytest.approx(walks * math.sqrt(seconds / 3), rel=0.15)


def test_the_bias_at_the_start_differs_between_episodes() -> None:
    noise = ImuNoise(gyro_white=0, gyro_walk=0, gyro_bias_std=0.01, accelerometer_bias_std=0.2)
    firsts = np.array([imu_errors(noise, 1, HZ, NoiseKey(1, episode, "imu"))[0] for episode in range(400)])
    assert firsts[:, :3].std() == pytest.approx(0.01, rel=0.1)


def test_noise_of_zero_changes_no_measurement() -> None:
    silent = ImuNoise(gyro_white=0, gyro_walk=0, accelerometer_white=0, accelerometer_walk=0)
    poses = wandering()
    a, b = sense_imu(imu(), poses, HZ, KEY), sense_imu(imu(noise=silent), poses, HZ, KEY)
    assert (a.specific_force == b.specific_force).all()
