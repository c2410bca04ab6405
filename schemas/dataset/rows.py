"""Models of the rows of a dataset's tables: archived episodes and failed attempts. Reads and writes no table."""

from __future__ import annotations

import json
from datetime import datetime
from typing import Annotated, Protocol

from pydantic import Field

from schemas.base import Bytes, Count, Finite, Line, Model, Name, NonNegative, Ordinal, PrimPath, Sha256
from schemas.episode import EpisodeMeta
from schemas.episode_spec import columns_of
from schemas.terms import EndReason, ExpertName, Split, Tier

_MAX_SOFTWARE_CHARS = 1 << 18
"""Largest length of the package versions as JSON; enough for every valid fingerprint."""
PUBLISHED_COLUMNS = (
    "episode_id",
    "split",
    "scene",
    "instruction",
    "target_category",
    "target_id",
    "spawn_tier",
    "spawn_dist_m",
    "num_steps",
    "trajectory_length_m",
    "final_ne_m",
    "collision_count",
    "template_id",
)
"""Columns of the published data set, in its order; the other columns follow them."""


class BundleReceipt(Protocol):
    """Facts of a validated bundle that the ledger needs; `EpisodeSummary` implements it."""

    @property
    def index(self) -> int:
        """Number of the job's episode in the plan."""

    @property
    def num_steps(self) -> int:
        """Number of simulated steps."""

    @property
    def content_digest(self) -> str:
        """Digest of the decoded content of the bundle, 32 hexadecimal digits."""

    @property
    def file_sha256(self) -> str:
        """SHA-256 of the bundle file."""

    @property
    def file_bytes(self) -> int:
        """Size of the bundle file, bytes."""

    def model_dump_json(self) -> str:
        """Returns the JSON text that the ledger stores."""


class EpisodeSummary(Model):
    """Row of `metadata.parquet`; the fields have the order of the columns."""

    episode_id: Name
    """Name of the episode, e.g. `ep_000001`."""
    split: Split
    """Split of the episode."""
    scene: Name
    """Name of the scene."""
    instruction: Line
    """Instruction, in the language of the plan; usually English."""
    target_category: Name
    """Category of the target."""
    target_id: Name
    """Name of the target within the scene."""
    spawn_tier: Tier
    """Distance tier of the start."""
    spawn_dist_m: NonNegative
    """Planar distance from the spawn to the target's centroid, metres."""
    num_steps: Ordinal
    """Number of frames and of actions, T."""
    trajectory_length_m: NonNegative
    """Trajectory length (TL), metres."""
    final_ne_m: NonNegative
    """Planar navigation error (NE) at the end, metres."""
    collision_count: Count
    """Number of steps in which the robot touches anything but the floor."""
    template_id: Name
    """Name of the instruction template."""

    index: Ordinal
    """Number of the episode in the plan."""
    colour: Name
    """Colour word of the target, or `unknown`."""
    phrase_is_unique: bool
    """Whether the instruction fits exactly one object of the scene."""
    target_prim_path: PrimPath
    """Path of the target's USD prim."""
    goal_x_m: Finite
    """x of the target's centroid in the world frame, metres."""
    goal_y_m: Finite
    """y of the target's centroid in the world frame, metres."""
    goal_z_m: Finite
    """z of the target's centroid in the world frame, metres."""
    spawn_x_m: Finite
    """x of base_link at frame 0 in the world frame, metres."""
    spawn_y_m: Finite
    """y of base_link at frame 0 in the world frame, metres."""
    spawn_yaw_rad: Finite
    """Yaw of base_link at frame 0 in the world frame, radians."""
    spawn_draws: Ordinal
    """Number of start poses tested in physics, the accepted one included."""
    expert: ExpertName
    """Controller that drove."""
    draw: Count
    """Number of times that target and template were drawn again."""
    attempt: Ordinal
    """Number of the attempt that succeeded."""
    end_reason: EndReason
    """Reason for the end of the rollout."""
    final_ne_3d_m: NonNegative
    """Navigation error at the end in three dimensions: distance to the target's centroid, metres."""
    min_ne_m: NonNegative
    """Smallest planar distance to the target's centroid over the episode, metres."""
    steps_visible: Count | None
    """Number of steps in which the target was visible to the expert; null if that was not recorded."""
    scene_sha256: Sha256
    """Digest of the compiled scene."""
    plan_digest: Sha256
    """Digest of the plan."""
    run: Line
    """Name of the run."""
    content_digest: Line
    """XXH3-128 over the decoded content; independent of the compressor."""
    file_sha256: Sha256
    """SHA-256 of the bundle file."""
    file_bytes: Annotated[Bytes, Field(ge=1)]
    """Size of the bundle file, bytes."""
    file_name: Line
    """Path of the bundle, relative to the dataset's directory."""
    format: Count
    """Version of the bundle format."""
    created_at: datetime
    """Time at which the episode was simulated, UTC."""
    worker: Line
    """Session id of the worker."""
    renderer: Line
    """Description of the renderer."""
    cpu: Line
    """CPU model name and machine type."""
    software: Annotated[str, Field(max_length=_MAX_SOFTWARE_CHARS)]
    """Package versions as JSON with sorted keys."""
    geodesic_m: NonNegative | None
    """Length of the shortest path along the floor from the spawn to the success region, metres; null if none exists."""
    spawn_surface_m: NonNegative | None = None
    """Planar distance from the spawn to the target's footprint, metres; null if the scene records no footprint."""
    final_surface_m: NonNegative | None = None
    """Planar distance from the last pose to the target's footprint, metres; null if the scene records no footprint."""
    target_in_view: bool | None = None
    """Whether the last frame shows the target; null in episodes of older versions."""


class FailedAttempt(Model):
    """Row of `attempts.parquet`: an attempt that produced no episode."""

    episode_id: Name
    """Name of the episode that was attempted."""
    draw: Annotated[int, Field(ge=0)]
    """Number of times that target and template were drawn again."""
    attempt: Annotated[int, Field(ge=1)]
    """Number of the attempt over all draws."""
    scene: Name
    """Name of the scene."""
    spawn_tier: Tier
    """Distance tier of the start."""
    split: Split
    """Split of the episode."""
    target_category: Name
    """Category of the target."""
    target_id: Name
    """Name of the target within the scene."""
    reason: str
    """Fail reason of `schemas.terms`, or how the lease ended."""
    detail: str = ""
    """Explanation with measured values."""
    steps: Annotated[int, Field(ge=0)] = 0
    """Number of steps simulated before the end."""
    seconds: NonNegative = 0.0
    """Wall time of the attempt, seconds."""
    worker: str = ""
    """Session id of the worker."""
    at: datetime
    """Time at which the attempt ended, UTC."""


def file_name_of(episode_id: str) -> str:
    """Returns the path of an episode's bundle, relative to the dataset's directory."""
    return f"episodes/{episode_id}.zip"


def renumbered(row: EpisodeSummary, index: int, episode_id: str) -> EpisodeSummary:
    """Returns the row of an episode with another number in its dataset.

    Args:
        row: row of the episode.
        index: number of the episode.
        episode_id: name of the episode with that number.
    """
    return row.model_copy(update={"index": index, "episode_id": episode_id, "file_name": file_name_of(episode_id)})


def summary_of(meta: EpisodeMeta, sha256: str, size: int) -> EpisodeSummary:
    """Returns the row of an episode.

    Args:
        meta: metadata of the bundle.
        sha256: SHA-256 of the bundle file.
        size: size of the bundle file, bytes.
    """
    job, rollout, provenance = meta.job, meta.rollout, meta.provenance
    goal_x, goal_y, goal_z = meta.target_centroid_m
    spawn_x, spawn_y, spawn_yaw = rollout.spawn_pose
    return EpisodeSummary(
        episode_id=meta.episode_id,
        **columns_of(job, EpisodeSummary) | {"instruction": meta.instruction, "template_id": meta.template_id},
        spawn_dist_m=rollout.spawn_dist_m,
        num_steps=rollout.num_steps,
        trajectory_length_m=rollout.trajectory_length_m,
        final_ne_m=rollout.final_ne_m,
        collision_count=rollout.collision_count,
        index=job.index,
        phrase_is_unique=meta.phrase_is_unique,
        target_prim_path=meta.target_prim_path,
        goal_x_m=goal_x,
        goal_y_m=goal_y,
        goal_z_m=goal_z,
        spawn_x_m=spawn_x,
        spawn_y_m=spawn_y,
        spawn_yaw_rad=spawn_yaw,
        spawn_draws=rollout.spawn_draws,
        expert=job.expert,
        draw=job.draw,
        attempt=job.attempt,
        end_reason=rollout.end_reason,
        final_ne_3d_m=rollout.final_ne_3d_m,
        min_ne_m=rollout.min_ne_m,
        steps_visible=rollout.steps_visible,
        scene_sha256=job.scene_sha256,
        plan_digest=job.plan_digest,
        run=job.run,
        content_digest=meta.content_digest,
        file_sha256=sha256,
        file_bytes=size,
        file_name=file_name_of(meta.episode_id),
        format=meta.format,
        created_at=provenance.created_at,
        worker=provenance.worker,
        renderer=provenance.fingerprint.renderer,
        cpu=provenance.fingerprint.cpu,
        software=json.dumps(provenance.fingerprint.software, sort_keys=True),
        geodesic_m=meta.route.geodesic_m,
        spawn_surface_m=rollout.spawn_surface_m,
        final_surface_m=rollout.final_surface_m,
        target_in_view=rollout.target_in_view,
    )
