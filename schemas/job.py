"""Model of a job as a worker receives it: all inputs of one attempt. Contains nothing about leases."""

from __future__ import annotations

import re
from typing import Annotated, Self

import numpy as np
from pydantic import Field

from schemas.base import Bytes, Count, Line, Ordinal, Sha256
from schemas.config import (
    CameraConfig,
    CorrectionConfig,
    DemonstrationConfig,
    ExpertConfig,
    PlannerConfig,
    RobotConfig,
    SpawnConfig,
    TaskConfig,
)
from schemas.episode_spec import EpisodeSpec
from schemas.instruction.start_view import StartView, TargetChoice
from schemas.language.language_file import LanguageSpec
from schemas.plan import MAX_EPISODES
from schemas.scene import Target
from schemas.terms import ExpertName, Recording
from schemas.view import ViewSettings

EPISODE_ID_FORMAT = "ep_{:06d}"
_EPISODE_FILE = re.compile(r"ep_(\d{6,7})\.zip", re.ASCII)
_SAMPLE_KEY, _LANGUAGE_KEY, _QUESTION_KEY, _CORRECTION_KEY = (1,), (23,), (25,), (31,)
"""Spawn keys of the random streams for sampled frames, the sentence, questions and corrections; the keys
differ from those of attempts."""


def episode_id(index: int) -> str:
    """Returns the name of the episode with an index; indices start at 1, as in the published data."""
    return EPISODE_ID_FORMAT.format(index)


def index_of_file(name: str) -> int | None:
    """Returns the episode number in a file name, or `None` if the name is not an episode's file name."""
    match = _EPISODE_FILE.fullmatch(name)
    if match is None:
        return None
    index = int(match[1])
    return index if index >= 1 and name == f"{episode_id(index)}.zip" else None


class Job(EpisodeSpec):
    """One attempt at one planned episode; a pure function of plan, scene, index and attempt."""

    run: Line
    """Name of the run that the job belongs to."""
    plan_digest: Sha256
    """Digest of the plan."""
    root_seed: Annotated[int, Field(ge=0, lt=2**63)]
    """Root seed of the run."""
    index: Annotated[int, Field(ge=1, le=MAX_EPISODES)]
    """Number of the episode in the plan, from 1."""
    draw: Count
    """Number of times that target and template were drawn again after too many failed attempts."""
    attempt: Ordinal
    """Number of the attempt over all draws, from 1; increases only after a failure of the task."""
    scene_sha256: Sha256
    """Digest of the compiled package."""
    scene_bytes: Annotated[Bytes, Field(ge=1)]
    """Size of the compiled package, bytes."""
    expert: ExpertName
    """Controller that drives."""
    task: TaskConfig
    """Parameters of the task."""
    robot: RobotConfig
    """Parameters of the robot."""
    camera: CameraConfig
    """Parameters of the camera."""
    spawn: SpawnConfig
    """Parameters of the spawn."""
    gains: ExpertConfig
    """Gains of the proportional controller."""
    planner: PlannerConfig = PlannerConfig()
    """Parameters of the planner expert."""
    start_view: StartView | None = Field(default=None, exclude_if=lambda view: view is None)
    """Conditions on the image at the start; omitted if there are none."""
    language: LanguageSpec | None = Field(default=None, exclude_if=lambda it: it is None)
    """Parameters of the sentence that the worker writes at the start; null and omitted for a template."""
    demonstration: DemonstrationConfig = Field(
        default=DemonstrationConfig(), exclude_if=lambda wanted: wanted == DemonstrationConfig()
    )
    """Requirements on a demonstration; omitted if there are none."""
    correction: CorrectionConfig | None = Field(default=None, exclude_if=lambda it: it is None)
    """Policy that drives, with the planner's actions beside it; null and omitted for a demonstration."""
    record: Recording = Field(default=Recording.FRAMES, exclude_if=lambda it: it is Recording.FRAMES)
    """Content that the episode stores; omitted for frames, so older digests stay valid."""
    view: ViewSettings = Field(default=ViewSettings(), exclude_if=lambda view: view == ViewSettings())
    """Rendering settings; omitted if they are the default, as in every states recording."""

    @property
    def episode_id(self) -> str:
        """Name of the episode, e.g. `ep_000001`."""
        return episode_id(self.index)

    @property
    def choice(self) -> TargetChoice | None:
        """Draw of the target at the start; `None` if the plan names the target."""
        return None if self.start_view is None else self.start_view.choice

    @property
    def faces_target(self) -> bool:
        """Whether the planner ends its paths with the target ahead."""
        correction = self.correction
        return self.demonstration.target_in_view or (correction is not None and correction.target_in_view)

    def aimed_at(self, target: Target) -> Self:
        """Returns the job with the target that was drawn at the start."""
        return self.model_copy(update={"target_id": target.target_id, "colour": target.colour})

    def rng(self) -> np.random.Generator:
        """Returns the random generator of the attempt, seeded with (root seed, index, attempt).

        Design: docs/design/reproducibility.md#seeds.
        """
        return np.random.default_rng(np.random.SeedSequence((self.root_seed, self.index, self.attempt)))

    def language_rng(self) -> np.random.Generator:
        """Returns the random generator of the attempt's sentence."""
        return np.random.default_rng(
            np.random.SeedSequence((self.root_seed, self.index, self.attempt), spawn_key=_LANGUAGE_KEY)
        )

    def question_rng(self) -> np.random.Generator:
        """Returns the random generator of the attempt's questions."""
        return np.random.default_rng(
            np.random.SeedSequence((self.root_seed, self.index, self.attempt), spawn_key=_QUESTION_KEY)
        )

    def correction_rng(self) -> np.random.Generator:
        """Returns the random generator of disturbances and of the choice who acts."""
        return np.random.default_rng(
            np.random.SeedSequence((self.root_seed, self.index, self.attempt), spawn_key=_CORRECTION_KEY)
        )

    def sampled_steps(self, steps: int) -> tuple[int, ...]:
        """Returns the steps whose frame digests a states recording stores: the first, the last and one drawn step.

        Args:
            steps: number of steps of the episode.
        """
        sequence = np.random.SeedSequence((self.root_seed, self.index, self.attempt), spawn_key=_SAMPLE_KEY)
        return tuple(sorted({0, int(np.random.default_rng(sequence).integers(steps)), steps - 1}))
