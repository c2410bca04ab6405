"""The metadata of an episode (`meta.json`): all the paper's sidecar lists, and what makes it reproducible."""

from __future__ import annotations

from datetime import datetime
from typing import Annotated

from pydantic import Field

from schemas.base import Model, Name, NonNegative
from schemas.fingerprint import Fingerprint
from schemas.job import Job
from schemas.plan import canonical_json
from schemas.scene import Instance
from schemas.terms import EndReason

__all__ = ["BUNDLE_FORMAT", "EpisodeMeta", "Provenance", "Rollout", "Route"]

BUNDLE_FORMAT = 1
"""Version of the bundle. A reader opens its own version and older ones; a newer one it refuses by name."""

Digest = Annotated[str, Field(pattern=r"^[0-9a-f]{32}$")]


class Rollout(Model):
    """What happened, measured in the world frame; every number can be computed again from the arrays."""

    end_reason: EndReason
    num_steps: Annotated[int, Field(ge=1, le=1000)]
    """T: number of frames and of actions."""
    spawn_pose: tuple[float, float, float]
    """x, y in metres and yaw in radians of base_link at frame 0."""
    spawn_dist_m: NonNegative
    """Planar distance from the spawn to the target's centroid."""
    spawn_draws: Annotated[int, Field(ge=1)]
    """Poses tried in physics until one held."""
    trajectory_length_m: NonNegative
    """TL: sum of planar distances between consecutive poses."""
    final_ne_m: NonNegative
    """NE: planar distance from the last pose to the target's centroid."""
    final_ne_3d_m: NonNegative
    """The same with the height of the centroid (DESIGN 3.2)."""
    min_ne_m: NonNegative
    """Smallest planar distance over the episode; oracle progress is made from it."""
    collision_count: Annotated[int, Field(ge=0)]
    """Steps with a contact other than the floor."""
    steps_visible: Annotated[int, Field(ge=0)]
    """Steps in which the target was visible to the expert."""


class Route(Model):
    """The way to the target as the scene's floor has it, whatever the expert drove."""

    geodesic_m: NonNegative | None = None
    """Length of the shortest way along the floor from the spawn to the success circle, metres; `None` where the
    floor does not connect them. The l of SPL."""
    planned: tuple[tuple[float, float, float], ...] = ()
    """Poses of the planner's path: x, y in metres and yaw in radians of base_link; empty for other experts."""


class Provenance(Model):
    """Where and when the bytes were made; never part of the content digest."""

    created_at: datetime
    """ISO-8601, UTC."""
    worker: str
    """Session id of the worker."""
    fingerprint: Fingerprint


class EpisodeMeta(Model):
    """The whole of `meta.json`."""

    format: int = BUNDLE_FORMAT
    episode_id: Name
    job: Job
    target_prim_path: str
    target_instance_id: int
    target_centroid_m: tuple[float, float, float]
    """Centre of the target's bounding box in the world frame."""
    phrase_is_unique: bool
    """Whether category and colour, as said, fit one target of the scene only."""
    rollout: Rollout
    route: Route = Route()
    instances: tuple[Instance, ...]
    """What the ids in `seg_front` mean."""
    frame_digests: tuple[Digest, ...]
    """XXH3-128 of (rgb, depth, ids) of every frame."""
    content_digest: Digest
    """XXH3-128 over the frame digests, the arrays and the canonical metadata without `provenance`."""
    provenance: Provenance

    def canonical(self) -> str:
        """Returns the part of the metadata that the content digest covers, as canonical JSON."""
        return canonical_json(self, exclude={"provenance", "content_digest", "frame_digests"})
