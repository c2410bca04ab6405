"""Rows of the tables of a dataset: archived episodes and failed attempts. Models; opens no table."""

from __future__ import annotations

import json
from datetime import datetime
from typing import Annotated, Protocol

from pydantic import Field

from schemas.base import Bytes, Count, Finite, Line, Model, Name, NonNegative, Ordinal, PrimPath, Sha256
from schemas.episode import EpisodeMeta
from schemas.episode_spec import columns_of
from schemas.terms import EndReason, ExpertName, Split, Tier

__all__ = ["PUBLISHED_COLUMNS", "BundleReceipt", "EpisodeSummary", "FailedAttempt", "file_name_of", "summary_of"]

_MAX_SOFTWARE_CHARS = 1 << 18
"""As JSON, whatever characters the names and versions of a fingerprint have."""
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
"""The columns of the published data set, in its order; every other column stands behind them."""


class BundleReceipt(Protocol):
    """What the ledger must know of a bundle that was found good; an `EpisodeSummary` is one."""

    @property
    def index(self) -> int:
        """Number of the job's episode."""

    @property
    def num_steps(self) -> int:
        """Simulated."""

    @property
    def content_digest(self) -> str:
        """Of what the bundle says, 32 hexadecimal digits."""

    @property
    def file_sha256(self) -> str:
        """Of the bundle."""

    @property
    def file_bytes(self) -> int:
        """Of the bundle."""

    def model_dump_json(self) -> str:
        """Returns it as the ledger keeps it."""


class EpisodeSummary(Model):
    """A row of `metadata.parquet`; the fields stand in the order of the columns."""

    episode_id: Name
    split: Split
    scene: Name
    instruction: Line
    target_category: Name
    target_id: Name
    spawn_tier: Tier
    spawn_dist_m: NonNegative
    """Planar distance from the spawn to the target's centroid, metres."""
    num_steps: Ordinal
    """T: frames and actions."""
    trajectory_length_m: NonNegative
    """TL, metres."""
    final_ne_m: NonNegative
    """NE, planar, metres."""
    collision_count: Count
    """Steps with a contact other than the floor."""
    template_id: Name

    index: Ordinal
    """Number of the episode in the plan."""
    colour: Name
    """Colour word of the target, or `unknown`."""
    phrase_is_unique: bool
    """Whether category and colour fit one target of the scene only."""
    target_prim_path: PrimPath
    goal_x_m: Finite
    goal_y_m: Finite
    goal_z_m: Finite
    """Centroid of the target in the world frame, metres."""
    spawn_x_m: Finite
    spawn_y_m: Finite
    spawn_yaw_rad: Finite
    """base_link at frame 0 in the world frame."""
    spawn_draws: Ordinal
    expert: ExpertName
    draw: Count
    """How often target and template were drawn anew."""
    attempt: Ordinal
    """Number of the attempt that succeeded."""
    end_reason: EndReason
    final_ne_3d_m: NonNegative
    min_ne_m: NonNegative
    steps_visible: Count
    """Steps in which the expert saw the target."""
    scene_sha256: Sha256
    """Digest of the compiled scene."""
    plan_digest: Sha256
    run: Line
    content_digest: Line
    """XXH3-128 over the decoded content; equal for equal content, whatever compressed it."""
    file_sha256: Sha256
    file_bytes: Annotated[Bytes, Field(ge=1)]
    file_name: Line
    """Path of the bundle below the dataset's directory."""
    format: Count
    """Version of the bundle."""
    created_at: datetime
    worker: Line
    renderer: Line
    cpu: Line
    software: Annotated[str, Field(max_length=_MAX_SOFTWARE_CHARS)]
    """Package versions as JSON with sorted keys."""
    geodesic_m: NonNegative | None
    """Shortest way along the floor from the spawn to the success circle, metres; null where there is none."""


class FailedAttempt(Model):
    """One row of `attempts.parquet`: an attempt that brought no episode."""

    episode_id: Name
    draw: Annotated[int, Field(ge=0)]
    attempt: Annotated[int, Field(ge=1)]
    scene: Name
    spawn_tier: Tier
    split: Split
    target_category: Name
    target_id: Name
    reason: str
    """A fail reason of `schemas.terms`, or how the lease ended."""
    detail: str = ""
    """Measured values, in words."""
    steps: Annotated[int, Field(ge=0)] = 0
    """Simulated before the end."""
    seconds: NonNegative = 0.0
    """Wall time spent."""
    worker: str = ""
    at: datetime


def file_name_of(episode_id: str) -> str:
    """Returns where an episode lies below the dataset's directory."""
    return f"episodes/{episode_id}.zip"


def summary_of(meta: EpisodeMeta, sha256: str, size: int) -> EpisodeSummary:
    """Returns the row of an episode.

    Args:
        meta: the bundle's metadata.
        sha256: digest of the bundle file.
        size: of the bundle file, bytes.
    """
    job, rollout, made = meta.job, meta.rollout, meta.provenance
    goal_x, goal_y, goal_z = meta.target_centroid_m
    spawn_x, spawn_y, spawn_yaw = rollout.spawn_pose
    return EpisodeSummary(
        episode_id=meta.episode_id,
        **columns_of(job, EpisodeSummary),
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
        created_at=made.created_at,
        worker=made.worker,
        renderer=made.fingerprint.renderer,
        cpu=made.fingerprint.cpu,
        software=json.dumps(made.fingerprint.software, sort_keys=True),
        geodesic_m=meta.route.geodesic_m,
    )
