"""Simulates one attempt at a job: finds a start pose, drives, and completes the bundle.

The result is a pure function of job and scene, except for provenance. A failed attempt returns a value and raises no
exception.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from functools import partial
from itertools import chain
from typing import BinaryIO

from schemas.bundle import BundleWriter, EpisodeArrays
from schemas.episode import EpisodeMeta, Provenance, Rollout, Route, format_of
from schemas.instruction.referents import referents_of
from schemas.job import Job
from schemas.measure import measure_track, shows_nothing
from schemas.scene import SceneInfo, Target
from schemas.terms import EndReason, FailReason, Recording
from workers.experts import Expert, make_expert
from workers.geometry.pose import Pose
from workers.physics.world import World
from workers.planning import Waypoint, geodesic_m
from workers.sim.aim import (
    Choices,
    EpisodeAim,
    SentenceSearch,
    ends_in_view,
    find_aim,
    is_view_clear,
    start_target,
    write_questions,
)
from workers.sim.appearance import show_appearance
from workers.sim.context import LoadedScene, SimulationContext
from workers.sim.correct import PolicyError, begin_correction
from workers.sim.recording import LoadedSurroundings, add_frames, add_measurements, add_sampled_digests
from workers.sim.rollout import Drive, drive
from workers.sim.spawn import draw_poses, is_spawn_stable

_NO_DIGEST = "0" * 32


@dataclass(frozen=True)
class Success:
    """Result of a successful attempt, whose bundle is complete."""

    meta: EpisodeMeta
    """Metadata of the episode, as written."""


@dataclass(frozen=True)
class AttemptFailure:
    """Result of a failed attempt; the caller discards the file."""

    reason: FailReason
    """Reason of the failure."""
    detail: str
    """Explanation with measured values."""
    steps: int
    """Number of simulated steps."""


Outcome = Success | AttemptFailure


@dataclass(frozen=True)
class _Attempt:
    """Data of an attempt whose start pose was accepted."""

    aim: EpisodeAim
    scene: LoadedScene
    context: SimulationContext
    out: BinaryIO
    """File that the bundle is written to."""
    sid: str
    """Session id of the worker."""
    on_step: Callable[[int], None]


def run_attempt(
    job: Job, context: SimulationContext, out: BinaryIO, sid: str, on_step: Callable[[int], None]
) -> Outcome:
    """Simulates one attempt and streams its bundle into `out`.

    Args:
        job: job to simulate; it seeds all random choices.
        context: renderer and scenes; the scene of the job must be loaded.
        out: seekable file, opened for writing.
        sid: session id of the worker, for the provenance.
        on_step: called after each step with the number of steps.
    """
    scene = context.loaded(job.scene_sha256)
    target = start_target(job, scene.compiled.info)
    rng = job.rng()
    context.renderer.load(
        scene.compiled, job.camera
    )  # loaded before the world is built, because both can need much memory
    choices = Choices(job, scene.compiled.info, context.renderer)
    is_clear = partial(is_view_clear, job, scene.compiled.info, context.renderer, choices=choices)
    sentences = SentenceSearch(job, scene, choices)

    def accepts(pose: Pose) -> bool:
        # many choices of targets lack a sentence, so sentences are tested before the physics
        return is_clear(pose) and sentences.accepts(pose)

    drawn = draw_poses(job, target, scene=scene, rng=rng, accepts=accepts)
    for draws, start in enumerate(chain(drawn, sentences.rejected_starts()), 1):
        with World(scene.compiled, scene.collider, job.robot, job.task.control_hz) as world:
            if not (is_spawn_stable(world, start, job) and is_clear(world.pose())):
                continue
            aim = find_aim(job, scene, context.renderer, world.pose(), choices)
            if aim is None:
                continue
            attempt = _Attempt(aim, scene, context=context, out=out, sid=sid, on_step=on_step)
            if aim.begun is not None:
                expert, path = aim.begun
                return _drive_and_seal(attempt, world, expert=expert, planned=path, draws=draws)
            expert = make_expert(aim.job)
            planned = expert.begin(world.pose(), scene.grid, aim.target)
            if planned is None:
                return AttemptFailure(
                    FailReason.NO_PATH, f"no drivable path to {aim.job.target_id} from {_pose_text(start)}", 0
                )
            if not ends_in_view(aim.job, aim.target, scene=scene, renderer=context.renderer, planned=planned):
                detail = f"the path from {_pose_text(start)} ends without {aim.job.target_id} in view"
                return AttemptFailure(FailReason.NOT_IN_VIEW, detail, 0)
            return _drive_and_seal(attempt, world, expert=expert, planned=planned, draws=draws)
    is_free = job.start_view is None and job.language is None
    conditions = "" if is_free else ", whose view meets the conditions of the instruction,"
    tries = f"in tier {job.tier} in {job.spawn.physics_draws} draws"
    return AttemptFailure(FailReason.SPAWN, f"no valid start pose{conditions} for {job.target_id} {tries}", 0)


def _pose_text(pose: Pose) -> str:
    return f"({pose.x:.2f}, {pose.y:.2f}) m, yaw {pose.yaw:.2f} rad"


def _drive_and_seal(
    attempt: _Attempt,
    world: World,
    expert: Expert,
    planned: tuple[Waypoint, ...],
    draws: int,
) -> Outcome:
    """Drives from the robot's current pose; completes the bundle after a success, else returns the failure."""
    aim, scene, context = attempt.aim, attempt.scene, attempt.context
    job, target = aim.job, aim.target
    start = world.pose()
    context.timer("start")
    try:
        rollout = _drive(attempt, world, expert)
    except PolicyError as error:
        return AttemptFailure(FailReason.POLICY, str(error), 0)
    poses = rollout.arrays.poses
    if rollout.end_reason is not EndReason.SUCCESS:
        if rollout.steps_visible == 0 and not job.is_false_premise:
            return AttemptFailure(FailReason.NO_VIEW, f"the target was never in view; {rollout.end}", len(poses))
        return AttemptFailure(FailReason(rollout.end_reason), rollout.end, len(poses))
    # frames are rendered after the success only, because those of a failed attempt would be discarded
    writer, shown = BundleWriter(attempt.out, context.timer), None
    if job.record is Recording.STATES:
        if add_sampled_digests(writer, context.renderer, job, poses):
            return _nothing_seen(start, len(poses))
    else:
        view = context.renderer.render_depth_and_ids(Pose.of(poses[0]))
        if shows_nothing(view.depth, view.ids):
            return _nothing_seen(start, len(poses))
        tell = partial(attempt.on_step, len(poses))
        shown = show_appearance(job, job.view.appearance, scene=scene, renderer=context.renderer, poses=poses)
        visible = add_frames(
            writer,
            shown.renderer,
            job=job,
            poses=poses,
            instance_id=target.instance_id,
            on_frame=lambda _frames: tell(),
        )
        rollout = replace(rollout, steps_visible=visible)
        surroundings = LoadedSurroundings(shown.scene, context.renderer)
        add_measurements(writer, surroundings, job=job, arrays=rollout.arrays, on_measurement=tell, change=shown.change)
    reach_m = None if job.is_false_premise else geodesic_m(scene.grid, (start.x, start.y), target, job.task)
    context.timer("route")
    route = Route(geodesic_m=reach_m, planned=planned)
    provenance = Provenance(created_at=datetime.now(UTC), worker=attempt.sid, fingerprint=context.fingerprint)
    meta = describe_episode(job, target, scene.compiled.info, rollout, route, draws, provenance)
    if aim.instruction is not None:
        questions = write_questions(job, scene, poses, aim.instruction)
        language = {"language": aim.instruction, "phrase_is_unique": aim.instruction.fits == 1, "questions": questions}
        meta = meta.model_copy(update={**language, "choices": aim.choices})
    if shown is not None:
        meta = meta.model_copy(update={"instances": shown.instances, "appearance": shown.drawn})
    sealed = writer.finish(rollout.arrays, meta)
    context.timer("bundle")
    return Success(sealed)


def _drive(attempt: _Attempt, world: World, expert: Expert) -> Drive:
    """Drives from the robot's current pose: the expert or, in an episode with corrections, the policy of this process.

    Raises:
        PolicyError: the policy failed.
    """
    aim, context = attempt.aim, attempt.context
    job, controller, policy = aim.job, expert, None
    if job.correction is not None:
        words = job.instruction if aim.instruction is None else aim.instruction.text
        controller = policy = begin_correction(job, expert, context.driver, attempt.scene.grid, words)
    rollout = drive(job, aim.target, world, context.renderer, controller, attempt.on_step, context.timer)
    if policy is None:
        return rollout
    return replace(rollout, arrays=replace(rollout.arrays, corrections=policy.corrections()))


def _nothing_seen(start: Pose, steps: int) -> AttemptFailure:
    return AttemptFailure(FailReason.NO_VIEW, f"the view from {_pose_text(start)} is one flat surface", steps)


def describe_episode(
    job: Job, target: Target, info: SceneInfo, rollout: Drive, route: Route, draws: int, provenance: Provenance
) -> EpisodeMeta:
    """Returns the metadata of a successful episode, without digests."""
    return EpisodeMeta(
        format=format_of(job),
        episode_id=job.episode_id,
        job=job,
        target_prim_path=target.prim_path,
        target_instance_id=target.instance_id,
        target_centroid_m=target.centroid_m,
        target_footprint_m=target.footprint_m,
        phrase_is_unique=len(referents_of(job, info)) == 1,
        rollout=_summarise(rollout.arrays, target, rollout, draws),
        route=route,
        instances=info.instances if job.record is Recording.FRAMES else (),
        frame_digests=(),
        content_digest=_NO_DIGEST,
        provenance=provenance,
    )


def _summarise(arrays: EpisodeArrays, target: Target, rollout: Drive, draws: int) -> Rollout:
    track = measure_track(arrays.poses, target.centroid_m, target.footprint_m)
    return Rollout(
        end_reason=rollout.end_reason,
        num_steps=len(arrays.poses),
        spawn_pose=track.spawn_pose,
        spawn_dist_m=track.spawn_dist_m,
        spawn_draws=draws,
        trajectory_length_m=track.trajectory_length_m,
        final_ne_m=track.final_ne_m,
        final_ne_3d_m=track.final_ne_3d_m,
        min_ne_m=track.min_ne_m,
        collision_count=rollout.contact_steps,
        steps_visible=rollout.steps_visible,
        spawn_surface_m=track.spawn_surface_m,
        final_surface_m=track.final_surface_m,
        target_in_view=rollout.target_in_view,
    )
