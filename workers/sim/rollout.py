"""One drive from a start pose to its end: observe, act, record, step. The loop every episode comes from.

Knows neither bundles nor leases; what it sees goes to a sink frame by frame.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from schemas.bundle import EpisodeArrays
from schemas.job import Job
from schemas.scene import Target
from schemas.support.stage_timer import StageTimer, no_stage_timer
from schemas.terms import EndReason
from workers.experts import Expert
from workers.physics.world import World
from workers.render import RenderedFrame, Renderer
from workers.sim.closed_loop import ClosedLoop

__all__ = ["Drive", "drive"]

FrameSink = Callable[[RenderedFrame], None]
"""Takes each frame as it is made."""
StepCallback = Callable[[int], None]
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
    on_step: StepCallback,
    lap: StageTimer = no_stage_timer,
) -> Drive:
    """Drives until success, collision or timeout.

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
    loop = ClosedLoop(job, target, world, renderer)
    visible = 0
    while True:
        view = loop.view
        frame = view.frame
        reason = loop.decide(expert.act(view))
        visible += view.sighting.pixels >= job.gains.min_mask_px
        lap("control")
        sink(frame)
        on_step(loop.steps)
        if reason is not None:
            end = f"{reason} after {loop.steps} steps, {view.distance_m:.2f} m from {target.target_id}"
            return Drive(reason, loop.arrays(), loop.contact_steps, visible, end)
        loop.advance()
        lap("physics")
