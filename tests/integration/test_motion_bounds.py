"""Physics and validation agree: validation accepts every motion of the simulated robot."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from coordinator.validation.motion import motion_findings
from schemas.bundle import EpisodeArrays
from schemas.config import RobotConfig
from schemas.tokens import tokens_of
from tests.builders.scene import box_room
from workers.geometry.slew import Twist, slew
from workers.physics.world import ColliderMesh, World

HZ = 60
ROBOT = RobotConfig()
Driver = Callable[[int], Twist]


def record(driver: Driver, start: tuple[float, float, float], steps: int = 150) -> tuple[EpisodeArrays, int]:
    scene = box_room()
    command, poses, actions, contacts = Twist(0.0, 0.0), [], [], 0
    with World(scene, ColliderMesh.from_scene(scene), ROBOT, HZ) as world:
        world.place(*start)
        for t in range(steps):
            pose = world.pose()
            contacts += world.has_obstacle_contact()
            command = slew(command, driver(t), ROBOT, 1 / HZ)
            poses.append((pose.x, pose.y, pose.z, pose.qw, pose.qx, pose.qy, pose.qz))
            actions.append(command)
            world.command(*command)
            world.step()
    continuous = np.array(actions, np.float32)
    return EpisodeArrays(continuous, tokens_of(continuous), np.array(poses)), contacts


DRIVES: dict[str, tuple[Driver, tuple[float, float, float]]] = {
    "straight and stop": (lambda t: Twist(1.0 if t < 90 else 0.0, 0.0), (-2.5, 0.0, 0.0)),
    "turn in place": (lambda _: Twist(0.0, 1.0), (0.0, 0.0, 0.0)),
    "wide bend": (lambda _: Twist(0.8, 0.4), (-2.5, -0.5, 0.0)),
    "slalom": (lambda t: Twist(0.5, 0.8 if t // 30 % 2 else -0.8), (-2.0, 0.0, 0.0)),
    "stand": (lambda _: Twist(0.0, 0.0), (0.0, 0.0, 1.0)),
    "full speed and full turn": (lambda t: Twist(1.0, 1.5 if t < 60 else 0.0), (-1.0, -0.5, 0.0)),
    "into the wall": (lambda _: Twist(0.8, 0.0), (2.5, -1.0, 0.0)),
    "along the wall": (lambda _: Twist(0.6, 0.0), (1.5, -2.0, -0.6)),
}


@pytest.mark.parametrize(("driver", "start"), DRIVES.values(), ids=DRIVES)
def test_simulated_drive_passes_motion_validation(driver: Driver, start: tuple[float, float, float]) -> None:
    arrays, contacts = record(driver, start)
    assert motion_findings(arrays, ROBOT, HZ, contacts) == []


def test_unreported_contact_is_found() -> None:
    """Validates an episode that reports no contact although a wall blocks the robot."""
    arrays, contacts = record(*DRIVES["into the wall"])
    assert contacts > 0
    assert any(
        "difference between driven and commanded distance" in finding
        for finding in motion_findings(arrays, ROBOT, HZ, 0)
    )


def test_shifted_commands_are_found() -> None:
    """Validates an episode whose actions are 0.2 s late relative to the poses."""
    arrays, contacts = record(*DRIVES["straight and stop"])
    late = np.concatenate([np.zeros((12, 2), np.float32), arrays.actions_continuous[:-12]])
    shifted = EpisodeArrays(late, tokens_of(late), arrays.poses)
    assert motion_findings(shifted, ROBOT, HZ, contacts) != []


def test_mirrored_turns_are_found() -> None:
    arrays, contacts = record(*DRIVES["turn in place"])
    mirrored = arrays.actions_continuous * np.array([1, -1], np.float32)
    assert motion_findings(EpisodeArrays(mirrored, tokens_of(mirrored), arrays.poses), ROBOT, HZ, contacts) != []
