"""Renders the frames of a states recording and writes the bundle that a frames recording would have.

The content digest is that of a simulation of the job. Does not simulate.
"""

from __future__ import annotations

import io
from collections.abc import Callable
from typing import BinaryIO

from schemas.bundle import BundleReader, BundleWriter
from schemas.episode import EpisodeMeta
from schemas.errors import WorldError
from schemas.job import Job
from schemas.terms import Recording
from workers.sim.attempt import Success
from workers.sim.frames import add_frames
from workers.sim.scene_renderer import LoadedScene, SceneRenderer


def render_recording(
    job: Job, stage: SceneRenderer, states: bytes, out: BinaryIO, on_step: Callable[[int], None]
) -> Success:
    """Renders the frames of a recorded episode and streams its bundle into `out`.

    Args:
        job: job of the episode, which records frames.
        stage: renderer and scenes; the scene of the job must be loaded.
        states: bundle of the states recording.
        out: seekable file, opened for writing.
        on_step: called after each frame with the number of frames.

    Raises:
        InvalidBundle: the recording is damaged.
        WorldError: the recording is of another job, or this renderer gives other frames than the recorded ones.
    """
    with BundleReader(io.BytesIO(states)) as recorded:
        _require_job(recorded.meta.job, job)
        place = stage.loaded(job.scene_sha256)
        stage.renderer.load(place.scene, job.camera)
        writer, target_id = BundleWriter(out, stage.lap), recorded.meta.target_instance_id
        visible = add_frames(writer, stage.renderer, job, recorded.arrays.poses, target_id, on_step)
        _require_same_frames(recorded.meta, writer.frame_digests, stage)
        return Success(writer.finish(recorded.arrays, _meta(recorded.meta, job, place, visible)))


def _require_job(recorded: Job, job: Job) -> None:
    """Raises `WorldError` unless a recording is of the job, apart from the plan, whose `record` differs."""
    of_plan = {"record": job.record, "plan_digest": job.plan_digest, "run": job.run}
    if recorded.record is not Recording.STATES or recorded.model_copy(update=of_plan) != job:
        raise WorldError(f"{job.episode_id}: the states are of another job: give the dataset that was recorded")


def _require_same_frames(meta: EpisodeMeta, rendered: tuple[str, ...], stage: SceneRenderer) -> None:
    sampled = meta.job.sampled_steps(len(rendered))
    differing = [t for t, digest in zip(sampled, meta.frame_digests, strict=True) if rendered[t] != digest]
    if differing:
        recorded_with = meta.provenance.fingerprint.renderer
        raise WorldError(
            f"{meta.episode_id}: frame {differing[0]} differs from the recorded digest; recorded with {recorded_with}, "
            f"rendered with {stage.renderer.description}: render with the recording's version of Mesa"
        )


def _meta(recorded: EpisodeMeta, job: Job, place: LoadedScene, visible: int) -> EpisodeMeta:
    """Returns the metadata of a frames recording, without digests; the provenance is that of the simulation."""
    return recorded.model_copy(
        update={
            "job": job,
            "rollout": recorded.rollout.model_copy(update={"steps_visible": visible}),
            "instances": place.scene.info.instances,
        }
    )
