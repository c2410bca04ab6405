"""Rollout of an expert from a start pose to the end of the episode: observe, act, record, step.

Renders only what the expert measures. Does not depend on bundles or leases.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from schemas.bundle import EpisodeArrays
from schemas.config import DemonstrationConfig
from schemas.job import Job
from schemas.scene import Target
from schemas.support.stage_timer import StageTimer, no_stage_timer
from schemas.terms import EndReason
from workers.experts import Expert
from workers.physics.world import World
from workers.render import Renderer
from workers.sim.closed_loop import ClosedLoop

StepCallback = Callable[[int], None]
"""Called after each step with the number of steps."""


@dataclass(frozen=True)
class Drive:
    """Result of a rollout."""

    end_reason: EndReason
    """Reason for the end."""
    arrays: EpisodeArrays
    """Recorded actions and poses."""
    contact_steps: int
    """Number of steps in which the robot touched anything other than the floor."""
    steps_visible: int | None
    """Number of steps in which the target was visible to the expert; `None` if the expert uses no images."""
    target_in_view: bool
    """Whether the last frame shows the target. Always false if an attempt fails whose expert uses no images."""
    end: str
    """Description of the end with measured values."""


def drive(
    job: Job,
    target: Target,
    world: World,
    renderer: Renderer,
    expert: Expert,
    on_step: StepCallback,
    timer: StageTimer = no_stage_timer,
) -> Drive:
    """Drives until success, collision, timeout or a missed requirement on the demonstration.

    Args:
        job: task, robot and camera settings.
        target: target to approach.
        world: world with the robot at its start pose.
        renderer: renderer with the scene loaded.
        expert: expert whose `begin` was called for this start; `act` is called once per step.
        on_step: called after every step.
        timer: called at the end of the stages `control` and `physics` of every step; the renderer reports its own.
    """
    loop = ClosedLoop(job, target, world, renderer)
    visible = 0 if job.expert.uses_images else None
    while True:
        view = loop.view
        reason = loop.decide(expert.act(view))
        is_needed = visible is not None or reason is EndReason.SUCCESS
        is_visible = is_needed and view.target_mask.pixels >= job.gains.min_mask_px
        if visible is not None:
            visible += is_visible
        reason = _missed(job.demonstration, reason, loop.contact_steps, is_visible) or reason
        timer("control")
        on_step(loop.steps)
        if reason is not None:
            place = f"at ({view.pose.x:.2f}, {view.pose.y:.2f}) m, {view.distance_m:.2f} m from {target.target_id}"
            end = f"{reason} after {loop.steps} steps {place}"
            return Drive(
                reason,
                loop.arrays(),
                contact_steps=loop.contact_steps,
                steps_visible=visible,
                target_in_view=is_visible,
                end=end,
            )
        loop.advance()
        timer("physics")


def _missed(
    wanted: DemonstrationConfig, reason: EndReason | None, contact_steps: int, is_visible: bool
) -> EndReason | None:
    """Returns the requirement that the demonstration misses with this frame, or `None`."""
    if wanted.max_contact_steps is not None and contact_steps > wanted.max_contact_steps:
        return EndReason.CONTACT
    if reason is EndReason.SUCCESS and wanted.target_in_view and not is_visible:
        return EndReason.NOT_IN_VIEW
    return None
