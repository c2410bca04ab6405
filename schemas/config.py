"""Numbers of the task, the robot, the camera, the spawn and the expert; each with its unit and source.

Holds values only. A plan may override any of them; what was used is recorded in every episode.
"""

from __future__ import annotations

from typing import Annotated

from pydantic import ConfigDict, Field

from schemas.base import Finite, Fraction, Line, Model, NonNegative, Positive

__all__ = ["CameraConfig", "ExpertConfig", "PlannerConfig", "RobotConfig", "SpawnConfig", "TaskConfig"]


class TaskConfig(Model):
    """When an episode ends and how it ends (paper Sec. II-A; docs/design/task.md#ends-of-an-episode)."""

    control_hz: Annotated[int, Field(ge=1, le=240)] = 60
    """Steps, frames and actions per second."""
    max_steps: Annotated[int, Field(ge=1, le=1000)] = 1000
    """Timeout, steps."""
    success_radius_m: Positive = 1.0
    """Largest planar base-to-centroid distance of a success, metres."""
    hold_steps: Annotated[int, Field(ge=1, le=1000)] = 5
    """Consecutive stationary steps inside the radius that make a success."""
    stationary_speed_mps: Positive = 0.02
    """Measured planar speed below which the robot is stationary, m/s."""
    stall_steps: Annotated[int, Field(ge=2, le=1000)] = 16
    """Window of the stall detection, steps."""
    stall_progress_m: Positive = 0.01
    """Net planar progress over the window below which the robot is stalled, metres."""
    near_obstacle_depth_m: Positive = 0.25
    """5th-percentile depth of the foreground crop below which an obstacle is near, metres."""
    crop_rows: tuple[Fraction, Fraction] = (0.55, 0.95)
    """Foreground crop, fraction of the image height from the top."""
    crop_columns: tuple[Fraction, Fraction] = (0.25, 0.75)
    """Foreground crop, fraction of the image width from the left."""


class RobotConfig(Model):
    """A robot with the measures of the Nova Carter (docs/design/robot.md)."""

    model_config = ConfigDict(populate_by_name=True, serialize_by_alias=True)

    wheel_radius_m: Positive = 0.14
    track_m: Positive = 0.4132
    """Distance between the wheels. The paper says 0.52 m, which no public source of the robot supports."""
    max_speed_mps: Positive = 1.0
    max_yaw_rate_rps: Positive = 1.5
    max_acceleration_mps2: Positive = 2.5
    """Slew limit of the speed command while speeding up, m/s2."""
    max_braking_mps2: Positive = 8.0
    """Slew limit of the speed command while slowing down, m/s2."""
    max_yaw_acceleration_rps2: Positive = 3.2
    """Slew limit of the yaw rate command, rad/s2."""
    motor_torque: Annotated[Positive, Field(alias="motor_force")] = 40.0
    """Largest wheel motor torque, N m. Files name it `motor_force`."""
    physics_substeps: Annotated[int, Field(ge=1, le=16)] = 4
    solver_iterations: Annotated[int, Field(ge=10, le=500)] = 100


class CameraConfig(Model):
    """The right eye of the front stereo camera as a pinhole; pose in base_link (docs/design/robot.md#camera)."""

    name: Line = "front_hawk/right"
    x_m: Finite = 0.1003
    y_m: Finite = -0.075
    z_m: Positive = 0.3444
    fov_deg: Annotated[float, Field(gt=1, lt=170)] = 90.0
    """Horizontal and vertical field of view; 90 degrees at 640 px is fx = fy = 320 px."""
    near_m: Positive = 0.05
    far_m: Positive = 30.0
    """Clip range along the optical axis; beyond it depth is 0."""


class SpawnConfig(Model):
    """Where an episode may start (paper Sec. III-D; docs/design/starts.md)."""

    heading_noise_rad: NonNegative = 0.4363323129985824
    """Largest deviation from facing the target in the near and mid tiers; 25 degrees."""
    physics_draws: Annotated[int, Field(ge=1, le=64)] = 8
    """How many poses an attempt tries in physics before it counts as a failed spawn."""
    grid_draws: Annotated[int, Field(ge=1, le=10000)] = 400
    """How many distances (far: surveyed points) a draw tries on the occupancy grid."""
    warmup_steps: Annotated[int, Field(ge=1, le=10_000)] = 3
    max_displacement_m: Positive = 0.08
    """Largest planar displacement during the warm-up, metres."""
    max_penetration_m: Positive = 0.005
    """Deepest overlap with anything but the floor, metres."""
    margin_m: NonNegative = 0.05
    """Free space demanded around the footprint, metres."""
    approach_clearance_m: NonNegative = 0.10
    """Free space beside the body on the straight line to the success circle, for experts that drive straight."""


class ExpertConfig(Model):
    """Gains of the proportional controller (paper Eq. 2-5; docs/design/experts.md#proportional-expert)."""

    yaw_gain: Positive = 1.4
    """k_w: rad/s per unit of normalised column error, and per radian of heading error."""
    speed_gain: Positive = 0.7
    """k_v, 1/s."""
    min_mask_px: Annotated[int, Field(ge=1, le=640 * 640)] = 32
    """Pixels of the target from which on it counts as visible."""
    avoidance_speed_mps: Positive = 0.1
    """Speed cap while an obstacle is near; above zero, so that a stall can be told."""


class PlannerConfig(Model):
    """Settings of the planner expert (docs/design/experts.md#planner); the other experts ignore them."""

    margin_m: NonNegative = 0.08
    """Free space around the footprint along the path, metres."""
    tight_margin_m: NonNegative = 0.02
    """The same where the wide margin leaves no way."""
    arrival_margin_m: NonNegative = 0.10
    """How far within the success circle the path ends, metres."""
    tight_arrival_margin_m: NonNegative = 0.05
    """The same where that leaves no way either."""
    stop_margin_m: NonNegative = 0.03
    """How far within the success circle the robot brakes, metres."""
    max_path_m: Positive = 10.0
    """Longest way along the floor to the success circle of a start in the far tier, metres."""
    max_expansions: Annotated[int, Field(ge=1, le=10_000_000)] = 60_000
    """Poses after which a search gives up."""
    look_ahead_m: Positive = 0.40
    """Distance of the point on the path that pure pursuit aims at, metres."""
    lateral_acceleration_mps2: Positive = 0.35
    """Speed times yaw rate that bends are slowed down to, m/s2; the tail-heavy robot skids beyond."""
