"""The metadata of an episode (`meta.json`): all the paper's sidecar lists, and what makes it reproducible."""

from __future__ import annotations

from datetime import datetime
from typing import Annotated

from pydantic import Field

from schemas.base import Count, Finite, Line, Model, Name, NonNegative, Ordinal, PrimPath
from schemas.fingerprint import Fingerprint
from schemas.job import Job
from schemas.plan import canonical_json
from schemas.scene import MAX_INSTANCES, Instance
from schemas.terms import EndReason

__all__ = ["BUNDLE_FORMAT", "MAX_FRAMES", "EpisodeMeta", "Provenance", "Rollout", "Route"]

BUNDLE_FORMAT = 1
"""Version of the bundle. A reader opens its own version and older ones; a newer one it refuses by name."""
MAX_FRAMES = 1000
"""Most steps of an episode."""
_MAX_PATH_POSES = 100_000

Digest = Annotated[str, Field(pattern=r"^[0-9a-f]{32}$")]


class Rollout(Model):
    """What happened, measured in the world frame; every number can be computed again from the arrays."""

    end_reason: EndReason
    num_steps: Annotated[int, Field(ge=1, le=MAX_FRAMES)]
    """T: number of frames and of actions."""
    spawn_pose: tuple[Finite, Finite, Finite]
    """x, y in metres and yaw in radians of base_link at frame 0."""
    spawn_dist_m: NonNegative
    """Planar distance from the spawn to the target's centroid."""
    spawn_draws: Ordinal
    """Poses tried in physics until one held."""
    trajectory_length_m: NonNegative
    """TL: sum of planar distances between consecutive poses."""
    final_ne_m: NonNegative
    """NE: planar distance from the last pose to the target's centroid."""
    final_ne_3d_m: NonNegative
    """The same with the height of the centroid (docs/design/task.md#distances)."""
    min_ne_m: NonNegative
    """Smallest planar distance over the episode; oracle progress is made from it."""
    collision_count: Count
    """Steps with a contact other than the floor."""
    steps_visible: Count
    """Steps in which the target was visible to the expert."""


class Route(Model):
    """The way to the target as the scene's floor has it, whatever the expert drove."""

    geodesic_m: NonNegative | None = None
    """Length of the shortest way along the floor from the spawn to the success circle, metres; `None` where the
    floor does not connect them. The l of SPL."""
    planned: Annotated[tuple[tuple[Finite, Finite, Finite], ...], Field(max_length=_MAX_PATH_POSES)] = ()
    """Poses of the planner's path: x, y in metres and yaw in radians of base_link; empty for other experts."""


class Provenance(Model):
    """Where and when the bytes were made; never part of the content digest."""

    created_at: datetime
    """ISO-8601, UTC."""
    worker: Line
    """Session id of the worker."""
    fingerprint: Fingerprint


class EpisodeMeta(Model):
    """The whole of `meta.json`."""

    format: Count = BUNDLE_FORMAT
    episode_id: Name
    job: Job
    target_prim_path: PrimPath
    target_instance_id: Annotated[int, Field(ge=0, le=MAX_INSTANCES)]
    target_centroid_m: tuple[Finite, Finite, Finite]
    """Centre of the target's bounding box in the world frame."""
    phrase_is_unique: bool
    """Whether category and colour, as said, fit one target of the scene only."""
    rollout: Rollout
    route: Route = Route()
    instances: Annotated[tuple[Instance, ...], Field(max_length=MAX_INSTANCES)]
    """What the ids in `seg_front` mean."""
    frame_digests: Annotated[tuple[Digest, ...], Field(max_length=MAX_FRAMES)]
    """XXH3-128 of (rgb, depth, ids) of every frame."""
    content_digest: Digest
    """XXH3-128 over the frame digests, the arrays and the canonical metadata without `provenance`."""
    provenance: Provenance

    def canonical(self) -> str:
        """Returns the part of the metadata that the content digest covers, as canonical JSON."""
        return canonical_json(self, exclude={"provenance", "content_digest", "frame_digests"})
