"""A job as a worker receives it: everything needed to simulate one attempt, nothing about leases."""

from __future__ import annotations

from typing import Annotated

import numpy as np
from pydantic import Field

from schemas.base import Bytes, Count, Line, Model, Name, Ordinal, Sha256
from schemas.config import CameraConfig, ExpertConfig, PlannerConfig, RobotConfig, SpawnConfig, TaskConfig
from schemas.plan import MAX_EPISODES
from schemas.terms import ExpertName, Split, Tier

__all__ = ["EPISODE_ID_FORMAT", "Job", "episode_id"]

EPISODE_ID_FORMAT = "ep_{:06d}"


def episode_id(index: int) -> str:
    """Returns the name of an episode; indices start at 1, as in the published data."""
    return EPISODE_ID_FORMAT.format(index)


class Job(Model):
    """One attempt at one planned episode; a pure function of plan, scene, index and attempt."""

    run: Line
    """Name of the run the job belongs to."""
    plan_digest: Sha256
    root_seed: Annotated[int, Field(ge=0, lt=2**63)]
    index: Annotated[int, Field(ge=1, le=MAX_EPISODES)]
    """Number of the episode in the plan, from 1."""
    draw: Count
    """How often target and template were drawn anew because the former ones were hopeless."""
    attempt: Ordinal
    """Number of the attempt over all draws, from 1; rises only when the world said no."""
    scene: Name
    scene_sha256: Sha256
    """Digest of the compiled package."""
    scene_bytes: Annotated[Bytes, Field(ge=1)]
    """Size of the compiled package."""
    tier: Tier
    split: Split
    category: Name
    target_id: Name
    colour: Name
    """Colour word that the instruction may use, or `unknown`."""
    template_id: Name
    instruction: Line
    expert: ExpertName
    task: TaskConfig
    robot: RobotConfig
    camera: CameraConfig
    spawn: SpawnConfig
    gains: ExpertConfig
    planner: PlannerConfig = PlannerConfig()

    @property
    def episode_id(self) -> str:
        """`ep_000001` and so on."""
        return episode_id(self.index)

    def rng(self) -> np.random.Generator:
        """Returns the attempt's generator, seeded by (root seed, index, attempt).

        Design: docs/design/reproducibility.md#seeds.
        """
        return np.random.default_rng(np.random.SeedSequence((self.root_seed, self.index, self.attempt)))
