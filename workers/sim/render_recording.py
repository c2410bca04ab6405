"""Renders the frames of a states recording and writes the bundle that a frames recording would have.

The content digest is that of a simulation of the job. Does not simulate.
"""

from __future__ import annotations

import io
from collections.abc import Callable
from functools import partial
from typing import BinaryIO

from schemas.bundle import BundleReader, BundleWriter
from schemas.errors import WorldError
from schemas.job import Job
from schemas.terms import Recording
from workers.render.differing import differing_frame
from workers.sim.appearance import show_appearance
from workers.sim.attempt import Success
from workers.sim.context import SimulationContext
from workers.sim.recording import LoadedSurroundings, add_frames, add_measurements


def render_recording(
    job: Job, context: SimulationContext, states: bytes, out: BinaryIO, on_step: Callable[[int], None]
) -> Success:
    """Renders the frames and the rig of a recorded episode and streams its bundle into `out`.

    Args:
        job: job of the episode, which records frames.
        context: renderer and scenes; the scene of the job must be loaded.
        states: bundle of the states recording.
        out: seekable file, opened for writing.
        on_step: called after each frame with the number of frames.

    Raises:
        InvalidBundle: the recording is damaged.
        WorldError: the recording is of another job, or the frames of this renderer differ from the recorded ones.
    """
    with BundleReader(io.BytesIO(states)) as recorded:
        _require_job(recorded.meta.job, job)
        scene = context.loaded(job.scene_sha256)
        shown = show_appearance(
            job, job.view.appearance, scene=scene, renderer=context.renderer, poses=recorded.arrays.poses
        )
        writer = BundleWriter(out, context.timer)
        # the recorded digests are of frames without varied appearance
        sampled = recorded.meta.sampled_digests if shown.drawn is None else {}

        def check(count: int) -> None:
            t = count - 1
            if t in sampled and writer.frame_digests[t] != sampled[t]:
                raise differing_frame(recorded.meta, t, context.renderer.description)
            on_step(count)

        target_id = recorded.meta.target_instance_id
        visible = add_frames(
            writer, shown.renderer, job=job, poses=recorded.arrays.poses, instance_id=target_id, on_frame=check
        )
        surroundings, tell = LoadedSurroundings(shown.scene, context.renderer), partial(on_step, recorded.length)
        add_measurements(
            writer, surroundings, job=job, arrays=recorded.arrays, on_measurement=tell, change=shown.change
        )
        meta = recorded.meta.with_frames(job, visible, shown.instances, shown.drawn)
        return Success(writer.finish(recorded.arrays, meta))


def _require_job(recorded: Job, job: Job) -> None:
    """Raises `WorldError` unless a states recording is of the job; record, view, plan and run may differ."""
    of_plan = {"record": job.record, "view": job.view, "plan_digest": job.plan_digest, "run": job.run}
    if recorded.record is not Recording.STATES or recorded.model_copy(update=of_plan) != job:
        raise WorldError(f"{job.episode_id}: the states are of another job: render the dataset that contains this job")
