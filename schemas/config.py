"""Parameters of the task, the robot, the camera, the spawn and the expert, with units and sources.

Contains values only. A plan may override each of them; every episode records the values it was made with.
"""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import ConfigDict, Field, model_validator

from schemas.base import Finite, Fraction, Line, Model, NonNegative, Positive, Sha256
from schemas.terms import FAR_FLOOR_M, Screening, SuccessMeasure


class TaskConfig(Model):
    """Parameters of the end of an episode (paper Sec. II-A; docs/design/task.md#ends-of-an-episode)."""

    control_hz: Annotated[int, Field(ge=1, le=240)] = 60
    """Steps, frames and actions per second."""
    max_steps: Annotated[int, Field(ge=1, le=1000)] = 1000
    """Timeout, steps."""
    success: SuccessMeasure = Field(
        default=SuccessMeasure.CENTROID, exclude_if=lambda it: it is SuccessMeasure.CENTROID
    )
    """Measure of the distance to the target; omitted from JSON if `centroid`, the only measure of the first versions.
    The default of a plan file is `surface`."""
    success_radius_m: Positive = 1.0
    """Largest planar distance from base_link to the target in a success, by the success measure, metres."""
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
    """Top and bottom of the foreground crop, fractions of the image height from the top."""
    crop_columns: tuple[Fraction, Fraction] = (0.25, 0.75)
    """Left and right side of the foreground crop, fractions of the image width from the left."""


class DemonstrationConfig(Model):
    """Requirements on a demonstration; an attempt that misses one has failed and is repeated from another start.

    Design: docs/design/task.md#demonstrations-have-separate-requirements.
    """

    max_contact_steps: Annotated[int, Field(ge=0, le=1000)] | None = None
    """Largest number of steps in which the robot touches anything but the floor; null: no limit, only
    recorded."""
    target_in_view: bool = False
    """Whether the last frame must show the target, with at least `gains.min_mask_px` pixels; the planner then ends its
    paths with the target ahead."""


class CorrectionConfig(Model):
    """Parameters of an episode that a policy drives, with the planner's action beside it.

    The planner takes over before a collision, after a stop outside the success region, and early enough to arrive
    within the step limit, so every recorded episode is a success. Design: docs/training/corrections.md.
    """

    policy: Line
    """Name of the policy, as `--policy` takes it."""
    made_from: Sha256
    """Digest of the hashes of its source files, of its checkpoint, or of its server's greeting."""
    round: Annotated[int, Field(ge=1, le=1000)] = 1
    """Number of the round of corrections."""
    expert_share: Fraction = 0.0
    """Probability that the planner acts in a label period although no takeover is due (beta of DAgger)."""
    disturbed_share: Fraction = 0.25
    """Share of episodes that begin with random actions for `disturbance_s`, which lead off the planner's paths."""
    disturbance_s: Annotated[float, Field(gt=0, le=5)] = 1.2
    """Time of random actions, seconds."""
    label_steps: Annotated[int, Field(ge=1, le=60)] = 6
    """Steps between two labels; who acts can change only then."""
    look_ahead_s: Annotated[float, Field(gt=0, le=5)] = 0.7
    """The planner takes over if the current command would lead to a collision within this time, seconds."""
    standstill_s: Annotated[float, Field(gt=0, le=10)] = 0.8
    """The planner takes over if the policy stands still outside the success region for this time, seconds."""
    takeover_s: Annotated[float, Field(gt=0, le=15)] = 2.0
    """Time for which the planner drives after a takeover, seconds."""
    takeovers: Annotated[int, Field(ge=0, le=100)] = 4
    """Number of takeovers after which the policy drives again; after the next one, the planner drives to the end."""
    target_in_view: bool = False
    """Whether the planner ends its paths with the target ahead, as `demonstration.target_in_view` of the training."""


class RobotConfig(Model):
    """Parameters of the robot, by default those of the Nova Carter (docs/design/robot.md)."""

    model_config = ConfigDict(populate_by_name=True, serialize_by_alias=True)

    wheel_radius_m: Positive = 0.14
    """Radius of the drive wheels, metres."""
    track_m: Positive = 0.4132
    """Distance between the drive wheels, metres. The paper states 0.52 m, which no public source supports."""
    max_speed_mps: Positive = 1.0
    """Largest commanded forward speed, m/s."""
    max_yaw_rate_rps: Positive = 1.5
    """Largest commanded yaw rate, rad/s."""
    max_acceleration_mps2: Positive = 2.5
    """Slew limit of the speed command during acceleration, m/s2."""
    max_braking_mps2: Positive = 8.0
    """Slew limit of the speed command during braking, m/s2."""
    max_yaw_acceleration_rps2: Positive = 3.2
    """Slew limit of the yaw rate command, rad/s2."""
    motor_torque: Annotated[Positive, Field(alias="motor_force")] = 40.0
    """Largest torque of a wheel motor, N m; serialized as `motor_force`."""
    physics_substeps: Annotated[int, Field(ge=1, le=16)] = 4
    """Physics steps in each control period."""
    solver_iterations: Annotated[int, Field(ge=10, le=500)] = 100
    """Iterations of the constraint solver in each physics step."""


class CameraConfig(Model):
    """Parameters of the pinhole camera, by default the right camera of the front pair (docs/design/robot.md#camera).

    The optical axis is parallel to x of base_link.
    """

    name: Line = "front_hawk/right"
    """Name of the camera."""
    x_m: Finite = 0.1003
    """x of the optical centre in base_link, metres."""
    y_m: Finite = -0.075
    """y of the optical centre in base_link, metres."""
    z_m: Positive = 0.3444
    """z of the optical centre in base_link, metres."""
    fov_deg: Annotated[float, Field(gt=1, lt=170)] = 90.0
    """Horizontal and vertical field of view, degrees; 90 degrees at 640 px is fx = fy = 320 px."""
    near_m: Positive = 0.05
    """Start of the clip range along the optical axis, metres."""
    far_m: Positive = 30.0
    """End of the clip range along the optical axis, metres; the depth of pixels beyond it is 0."""


class SpawnConfig(Model):
    """Parameters of the start of an episode (paper Sec. III-D; docs/design/starts.md)."""

    heading_noise_rad: NonNegative = 0.4363323129985824
    """Largest heading offset from the direction to the target in the near and mid tiers, radians; 25 degrees."""
    physics_draws: Annotated[int, Field(ge=1, le=64)] = 8
    """Largest number of start poses that an attempt tests in physics before it fails with the reason `spawn`."""
    grid_draws: Annotated[int, Field(ge=1, le=10000)] = 400
    """Largest number of distances (far tier: of surveyed points) that a draw tests on the occupancy grid."""
    warmup_steps: Annotated[int, Field(ge=1, le=10_000)] = 3
    """Length of the warm-up in which the robot must keep its place, steps."""
    max_displacement_m: Positive = 0.08
    """Largest planar displacement during the warm-up, metres."""
    max_penetration_m: Positive = 0.005
    """Largest overlap with any body other than the floor, metres."""
    margin_m: NonNegative = 0.05
    """Required free space around the footprint, metres."""
    approach_clearance_m: NonNegative = 0.10
    """Required free space beside the body on the straight line to the success circle, for experts that drive straight,
    metres."""
    screening: Screening = Field(default=Screening.FORESEEN, exclude_if=lambda it: it is Screening.FORESEEN)
    """Selection of the starts of experts that drive straight; the planner ignores it. Omitted from JSON if
    `foreseen`, the only selection of the first versions."""
    far_floor_m: tuple[Positive, Positive] = Field(default=FAR_FLOOR_M, exclude_if=lambda it: it == FAR_FLOOR_M)
    """Smallest and largest distance along the floor from a start in the far tier to the target, metres: the shortest
    path to the success circle plus its radius. Omitted from JSON at the default."""

    @property
    def needs_free_line(self) -> bool:
        """Whether starts of experts that drive straight need a free straight line to the success region."""
        return self.screening in {Screening.FREE_LINE, Screening.FORESEEN}

    @model_validator(mode="after")
    def _far_range_is_ordered(self) -> SpawnConfig:
        low, high = self.far_floor_m
        if low >= high:
            raise ValueError(f"far_floor_m: the first value, {low:g} m, must be less than the second, {high:g} m")
        return self


class InstructionConfig(Model):
    """Parameters of the instructions (docs/design/starts.md#start-view)."""

    unique: Literal["scene", "view", "off"] = "off"
    """Where an instruction must fit exactly one object. `scene`: in the scene. `view`: in the scene or in the view at
    the start. `off`: an instruction may fit several objects."""


class ExpertConfig(Model):
    """Gains of the proportional controller (paper Eq. 2-5; docs/design/experts.md#proportional-expert)."""

    yaw_gain: Positive = 1.4
    """Gain k_w: rad/s per unit of normalised column error, and per radian of heading error."""
    speed_gain: Positive = 0.7
    """Gain k_v, 1/s."""
    min_mask_px: Annotated[int, Field(ge=1, le=640 * 640)] = 32
    """Smallest mask of a visible target, pixels."""
    avoidance_speed_mps: Positive = 0.1
    """Speed limit while an obstacle is near, m/s; above zero, so a stall can be detected."""


class PlannerConfig(Model):
    """Parameters of the planner expert (docs/design/experts.md#planner); the other experts ignore them."""

    margin_m: NonNegative = 0.08
    """Free space around the footprint along the path, metres."""
    tight_margin_m: NonNegative = 0.02
    """Free space around the footprint if no path exists with `margin_m`, metres."""
    arrival_margin_m: NonNegative = 0.10
    """Distance by which the path ends inside the edge of the success region, metres."""
    tight_arrival_margin_m: NonNegative = 0.05
    """Distance that replaces `arrival_margin_m` if no path ends that far inside the edge, metres."""
    stop_margin_m: NonNegative = 0.03
    """Distance inside the edge of the success region at which the robot starts to brake, metres."""
    max_path_m: Positive = 10.0
    """Longest distance along the floor from a start in the far tier to the success region, metres."""
    # longer drives do not reliably fit into the 1000 steps of an episode
    max_expansions: Annotated[int, Field(ge=1, le=10_000_000)] = 60_000
    """Largest number of poses that a search expands."""
    look_ahead_m: Positive = 0.40
    """Look-ahead distance of pure pursuit, metres."""
    lateral_acceleration_mps2: Positive = 0.35
    """Largest lateral acceleration in bends (speed times yaw rate), m/s2; the tail-heavy robot skids above it."""
