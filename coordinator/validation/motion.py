"""Checks whether the recorded poses are consistent with the recorded commands.

The module bounds the motion of a differential drive per period, with named tolerances. It does not simulate, and
accepts a robot that an obstacle blocks.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from schemas.bundle import EpisodeArrays
from schemas.config import RobotConfig
from schemas.support.geometry import yaw_of

F64 = NDArray[np.float64]

COMMAND_SLACK = 1e-4
"""Tolerance of commands, m/s and rad/s, for the float32 rounding of a command and of the previous command."""
QUATERNION_SLACK = 1e-3
"""Tolerated deviation of a quaternion's norm from 1. Physics normalises at every step; float32 rounding is 1e-7."""
HEIGHT_SLACK_M = 0.03
"""Tolerated height change of base_link from frame 0, metres. The floor is flat, and the springs move by millimetres."""
MAX_TILT_RAD = 0.10
"""Maximum tilt of base_link, radians. Braking at 8 m/s2 tilts it by about 0.01, an obstacle by a few hundredths."""
LAG_STEPS = 6
"""Number of periods for which the wheels may follow an older command; 0.1 s at 60 Hz."""
STEP_SLACK_M = 0.003
"""Tolerated displacement per step beyond the command, metres. Without contact, less than 0.001 was measured."""
CONTACT_STEP_SLACK_M = 0.02
"""Tolerated displacement per step with contact, metres. The solver separates overlaps by less than 0.011 (measured)."""
SIDE_SLACK_M = 0.003
"""Tolerated lateral displacement per step, metres. In successes without contact, less than 0.0005 was measured."""
YAW_STEP_SLACK_RAD = 0.015
"""Tolerated turn per step beyond command and skid without contact, radians. In 220 successes, at most 0.0063 was
measured."""
CONTACT_YAW_STEP_SLACK_RAD = 0.08
"""Tolerated turn per step with contact, radians. Off-centre pushes turn the robot by less than 0.034 (measured)."""
PATH_SLACK_M, PATH_SLACK_SHARE = 0.05, 0.05
"""Tolerance (metres, share) of the driven distance in a window without contact. Wheels follow commands within 0.2 %."""
TURN_SLACK_RAD, TURN_SLACK_SHARE = 0.10, 0.10
"""Tolerance (radians, share) of the turned angle in a window without contact and skid."""
SKID_TURN = 4.0
"""Additional tolerated turn in fast bends: radians per radian of commanded turn and per m/s of commanded speed. The
tail-heavy robot oversteers in fast bends and can spin at 5 rad/s (4 of 700 episodes, all timeouts). Slow turns and
straight motion have no allowance."""
SKID_PATH_M = 1.0
"""Additional tolerated error of the driven distance in a bend, metres for each second and each m/s2 of `_Drive.bend`.
For a spinning robot, up to 0.65 was measured."""
SKID_STEP_M = 0.008
"""Additional tolerated displacement per step in a bend, in any direction, metres for each m/s2 of `_Drive.bend`."""
SKID_STEPS = 90
"""Number of periods for which a skid may outlast its bend."""
WINDOW_STEPS = 60
"""Number of periods over which distance and angle are summed."""


@dataclass(frozen=True)
class _Drive:
    """Commands and increments of an episode; increment t is the motion from pose t to pose t + 1 under command t."""

    v: F64
    """(T,) commanded speed, m/s."""
    w: F64
    """(T,) commanded yaw rate, rad/s."""
    along: F64
    """(T - 1,) displacement along the heading, metres."""
    aside: F64
    """(T - 1,) displacement to the left, metres."""
    turned: F64
    """(T - 1,) change of heading, radians."""
    bend: F64
    """(T - 1,) recent maximum of commanded speed times yaw rate, m/s2."""
    hz: int
    """Control frequency, Hz."""
    touched: bool
    """Whether the episode reports any contact."""


def motion_findings(arrays: EpisodeArrays, robot: RobotConfig, control_hz: int, collision_count: int) -> list[str]:
    """Returns the violations of the robot's limits and the contradictions between poses and commands.

    Args:
        arrays: arrays of the episode, which satisfy their specs.
        robot: limits of speed and acceleration.
        control_hz: control frequency, Hz.
        collision_count: recorded number of steps with contact; with contact the bounds are wider.
    """
    drive = _drive_of(arrays, control_hz, collision_count > 0)
    return [
        *_command_findings(drive, robot),
        *_stance_findings(arrays.poses),
        *_step_findings(drive),
        *_window_findings(drive),
    ]


def _drive_of(arrays: EpisodeArrays, control_hz: int, touched: bool) -> _Drive:
    poses = arrays.poses
    yaw = yaw_of(poses)
    turned = (np.diff(yaw) + np.pi) % (2 * np.pi) - np.pi
    heading = yaw[:-1] + turned / 2
    dx, dy = np.diff(poses[:, 0]), np.diff(poses[:, 1])
    v, w = arrays.actions_continuous.astype(np.float64).T
    along = dx * np.cos(heading) + dy * np.sin(heading)
    aside = dy * np.cos(heading) - dx * np.sin(heading)
    bend = _recent_maximum(v * np.abs(w), SKID_STEPS)[:-1]
    return _Drive(v, w, along=along, aside=aside, turned=turned, bend=bend, hz=control_hz, touched=touched)


def _command_findings(drive: _Drive, robot: RobotConfig) -> list[str]:
    dv, dw = (np.diff(command, prepend=0.0) * drive.hz for command in (drive.v, drive.w))
    slack = COMMAND_SLACK * drive.hz
    return [
        *_beyond("speed command", "m/s", drive.v, robot.max_speed_mps, COMMAND_SLACK),
        *_beyond("yaw rate command", "rad/s", np.abs(drive.w), robot.max_yaw_rate_rps, COMMAND_SLACK),
        *_beyond("speeding up", "m/s2", dv, robot.max_acceleration_mps2, slack),
        *_beyond("braking", "m/s2", -dv, robot.max_braking_mps2, slack),
        *_beyond("change of the yaw rate", "rad/s2", np.abs(dw), robot.max_yaw_acceleration_rps2, slack),
    ]


def _stance_findings(poses: F64) -> list[str]:
    quaternions = poses[:, 3:]
    norm_error = np.abs(np.linalg.norm(quaternions, axis=1) - 1)
    findings = _beyond("deviation of the quaternion's norm from 1", "", norm_error, QUATERNION_SLACK, 0.0)
    up_z = np.clip(1 - 2 * (quaternions[:, 1] ** 2 + quaternions[:, 2] ** 2), -1, 1)
    if not findings:  # the tilt of an invalid quaternion is meaningless
        findings = _beyond("tilt", "rad", np.arccos(up_z), MAX_TILT_RAD, 0.0)
    heights = poses[:, 2]
    return findings + _beyond("height above the first frame", "m", np.abs(heights - heights[0]), HEIGHT_SLACK_M, 0.0)


def _step_findings(drive: _Drive) -> list[str]:
    period = 1 / drive.hz
    reach = _recent_maximum(drive.v, LAG_STEPS)[:-1] * period
    turn = (_recent_maximum(np.abs(drive.w), LAG_STEPS)[:-1] + SKID_TURN * drive.bend) * period
    step_slack = CONTACT_STEP_SLACK_M if drive.touched else STEP_SLACK_M
    side_slack = CONTACT_STEP_SLACK_M if drive.touched else SIDE_SLACK_M
    yaw_slack = CONTACT_YAW_STEP_SLACK_RAD if drive.touched else YAW_STEP_SLACK_RAD
    moved, skid = np.hypot(drive.along, drive.aside), SKID_STEP_M * drive.bend
    return [
        *_beyond("displacement in a step beyond the command", "m", moved - reach - skid, step_slack, 0.0),
        *_beyond("displacement backwards in a step", "m", -drive.along - skid, step_slack, 0.0),
        *_beyond("displacement sideways in a step", "m", np.abs(drive.aside) - skid, side_slack, 0.0),
        *_beyond("turn in a step beyond the command", "rad", np.abs(drive.turned) - turn, yaw_slack, 0.0),
    ]


def _window_findings(drive: _Drive) -> list[str]:
    if drive.touched or len(drive.along) == 0:
        return []
    period = 1 / drive.hz
    wanted, wanted_turn = _window_sums(drive.v[:-1] * period), _window_sums(drive.w[:-1] * period)
    effort, skid = _window_sums(np.abs(drive.w[:-1]) * period), _window_sums(drive.bend * period)
    path_error = np.abs(_window_sums(drive.along) - wanted) - PATH_SLACK_SHARE * wanted - SKID_PATH_M * skid
    turn_error = np.abs(_window_sums(drive.turned) - wanted_turn) - TURN_SLACK_SHARE * effort - SKID_TURN * skid
    return [
        *_beyond("difference between driven and commanded distance in a window", "m", path_error, PATH_SLACK_M, 0.0),
        *_beyond("difference between turned and commanded angle in a window", "rad", turn_error, TURN_SLACK_RAD, 0.0),
    ]


def _recent_maximum(command: F64, steps: int) -> F64:
    padded = np.concatenate([np.zeros(steps), command])
    recent: F64 = np.lib.stride_tricks.sliding_window_view(padded, steps + 1).max(axis=1)
    return recent


def _window_sums(values: F64) -> F64:
    width = min(WINDOW_STEPS, len(values))
    total: F64 = np.concatenate([[0.0], np.cumsum(values)])
    sums: F64 = total[width:] - total[:-width]
    return sums


def _beyond(what: str, unit: str, values: F64, limit: float, slack: float) -> list[str]:
    """Returns a finding with the worst value and the number of violations, or an empty list."""
    bad = ~(values <= limit + slack)
    if not bad.any():
        return []
    worst = int(np.argmax(np.where(bad, values, -np.inf)))
    text = f"{what}: {values[worst]:.4g} {unit}".rstrip()
    return [f"{text} at step {worst}, limit {limit:.4g}; {int(bad.sum())} steps beyond it"]
