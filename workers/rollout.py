"""One drive from a start pose to its end: observe, act, record, step. The loop every episode comes from.

Knows neither bundles nor leases; what it sees goes to a sink frame by frame.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from schemas.bundle import EpisodeArrays
from schemas.job import Job
from schemas.lap import Lap, no_lap
from schemas.scene import Target
from schemas.terms import EndReason
from schemas.tokens import tokens_of
from workers.experts import Expert, Observation
from workers.pose import Pose
from workers.render import Frame, Renderer
from workers.sight import is_obstacle_near, see
from workers.slew import Twist, slew
from workers.termination import Termination
from workers.world import World

__all__ = ["Drive", "drive"]

FrameSink = Callable[[Frame], None]
"""Takes each frame as it is made."""
StepListener = Callable[[int], None]
"""Is told the number of steps done."""


@dataclass(frozen=True)
class Drive:
    """What a rollout left behind."""

    end_reason: EndReason
    arrays: EpisodeArrays
    contact_steps: int
    """Steps with a contact other than the floor."""
    steps_visible: int
    """Steps in which the target's mask was large enough for the expert."""
    end: str
    """The end in words, with measured values."""


def drive(
    job: Job,
    target: Target,
    world: World,
    renderer: Renderer,
    expert: Expert,
    sink: FrameSink,
    on_step: StepListener,
    lap: Lap = no_lap,
) -> Drive:
    """Drives until success, collision or timeout.

    Frame t and pose t are taken before action t; the last action is recorded, not carried out, so that every array
    has the length T and the poses alone prove the end (DESIGN 5).

    Args:
        job: task, robot and camera settings.
        target: the object to approach.
        world: with the robot standing at its start.
        renderer: with the scene loaded.
        expert: has begun at this start; asked once a step.
        sink: takes every frame.
        on_step: told after every step.
        lap: told the end of the stages `control` and `physics` of every step; renderer and sink tell theirs.
    """
    termination = Termination(job.task)
    poses: list[tuple[float, ...]] = []
    actions: list[Twist] = []
    command = Twist(0.0, 0.0)
    contacts = visible = 0
    while True:
        pose = world.pose()
        frame = renderer.render(pose)
        seen = _observe(frame, pose, target, job)
        touching = world.has_obstacle_contact()
        command = slew(command, expert.act(seen), job.robot, 1.0 / job.task.control_hz)
        lap("control")
        sink(frame)
        poses.append((pose.x, pose.y, pose.z, pose.qw, pose.qx, pose.qy, pose.qz))
        actions.append(command)
        contacts += touching
        visible += seen.sighting.pixels >= job.gains.min_mask_px
        blocked = touching or seen.obstacle_near
        reason = termination.judge(pose.x, pose.y, seen.distance_m, blocked, command.v_mps)
        on_step(len(actions))
        lap("control")
        if reason is not None:
            end = f"{reason} after {len(actions)} steps, {seen.distance_m:.2f} m from {target.target_id}"
            return Drive(reason, _arrays(actions, poses), contacts, visible, end)
        world.command(command.v_mps, command.w_rps)
        world.step()
        lap("physics")


def _observe(frame: Frame, pose: Pose, target: Target, job: Job) -> Observation:
    dx, dy = target.centroid_m[0] - pose.x, target.centroid_m[1] - pose.y
    return Observation(
        sighting=see(frame.ids, frame.depth, target.instance_id, job.gains.min_mask_px),
        bearing_rad=math.remainder(math.atan2(dy, dx) - pose.yaw, 2 * math.pi),
        distance_m=math.hypot(dx, dy),
        obstacle_near=is_obstacle_near(frame.depth, job.task),
        pose=pose,
    )


def _arrays(actions: list[Twist], poses: list[tuple[float, ...]]) -> EpisodeArrays:
    continuous: NDArray[np.float32] = np.array(actions, np.float32)
    return EpisodeArrays(continuous, tokens_of(continuous), np.array(poses, np.float32))
