"""Evaluation episodes as data: where the robot starts, what it is told, what counts. Models only; opens nothing.

The same set gives the same numbers with the same policy and software.
"""

from __future__ import annotations

import hashlib
from typing import Annotated, Literal

from pydantic import Field, model_validator

from schemas.base import Model, Name, NonNegative, Sha256
from schemas.config import CameraConfig, ExpertConfig, PlannerConfig, RobotConfig, SpawnConfig, TaskConfig
from schemas.episode_spec import EpisodeSpec
from schemas.errors import UsageError
from schemas.job import Job
from schemas.plan import Plan, canonical_json
from schemas.terms import ExpertName, Split

__all__ = ["SPECS_FORMAT", "EvalSettings", "EvalSpec", "SpecSet", "spread"]

SPECS_FORMAT = 1
"""Version of the file of specs. A reader opens its own version and older ones; a newer one it refuses by name."""
_NO_PLAN = "0" * 64


class EvalSettings(Model):
    """What all episodes of a set share; the numbers the dataset was collected with."""

    task: TaskConfig = TaskConfig()
    """Success, collision and timeout; `max_steps` is the limit of an episode."""
    robot: RobotConfig = RobotConfig()
    camera: CameraConfig = CameraConfig()
    spawn: SpawnConfig = SpawnConfig()
    gains: ExpertConfig = ExpertConfig()
    """Of the experts, and how large a mask counts as in view."""
    planner: PlannerConfig = PlannerConfig()

    @classmethod
    def of(cls, source: Plan | Job) -> EvalSettings:
        """Returns the settings of a plan or a job."""
        return cls(**{name: getattr(source, name) for name in cls.model_fields})


class EvalSpec(EpisodeSpec):
    """One episode to be driven."""

    spec_id: Name
    """Unique within its set."""
    scene_sha256: Sha256
    """Digest of the compiled package."""
    seed: Annotated[int, Field(ge=0, lt=2**32)]
    """For the policy's own chances; the simulation has none."""
    spawn_pose: tuple[float, float, float]
    """x, y in metres and yaw in radians at which base_link is put down, before the warm-up steps."""
    spawn_source: Literal["job", "frame", "drawn"]
    """`job`: drawn again as the collection drew it, to the last bit; `frame`: frame 0 of the episode, where another
    version of the software collected it; `drawn`: drawn for this set."""
    spawn_dist_m: NonNegative
    """Planar distance from the spawn to the target's centroid."""
    geodesic_m: NonNegative | None
    """Shortest way along the floor to the success circle; the l of SPL. `None` where there is none."""
    categories_in_view: tuple[Name, ...]
    """Categories of which an object is in view at the start, by name."""
    is_target_in_view: bool
    """Whether the target itself is in view at the start."""
    source_episode: Name | None = None
    """The archived episode it was taken from."""

    def job(self, settings: EvalSettings, expert: ExpertName = ExpertName.PROPORTIONAL) -> Job:
        """Returns the spec as a job, the form in which simulation and experts take it."""
        return Job(
            **dict(EpisodeSpec.of(self)),
            run="evaluation",
            plan_digest=_NO_PLAN,
            root_seed=self.seed,
            index=1,
            draw=0,
            attempt=1,
            scene_sha256=self.scene_sha256,
            scene_bytes=1,
            expert=expert,
            **{name: getattr(settings, name) for name in EvalSettings.model_fields},
        )


class SpecSet(Model):
    """The whole file of specs."""

    format: int = SPECS_FORMAT
    source: str
    """Where the specs come from, in words."""
    run: str
    """Name of the run whose dataset has the scenes."""
    settings: EvalSettings
    specs: Annotated[tuple[EvalSpec, ...], Field(min_length=1)]

    @model_validator(mode="after")
    def _ids_are_unique(self) -> SpecSet:
        names = [spec.spec_id for spec in self.specs]
        if len(set(names)) < len(names):
            twice = sorted({name for name in names if names.count(name) > 1})
            raise ValueError(f"duplicate specs: {', '.join(twice[:5])}")
        return self

    @property
    def digest(self) -> str:
        """SHA-256 of what decides the numbers: settings and specs."""
        return hashlib.sha256(canonical_json(self, exclude={"source", "run"}).encode()).hexdigest()

    def spec_digest(self, spec: EvalSpec) -> str:
        """SHA-256 of one spec with the settings: results with equal digests answer the same question."""
        text = canonical_json(self.settings) + canonical_json(spec)
        return hashlib.sha256(text.encode()).hexdigest()

    def only(self, splits: frozenset[Split] | None = None, episodes: int | None = None) -> SpecSet:
        """Returns the set with some splits only, and of those at most `episodes`, spread evenly over the list.

        Raises:
            UsageError: none is left.
        """
        specs = [spec for spec in self.specs if splits is None or spec.split in splits]
        specs = [specs[place] for place in spread(len(specs), episodes)]
        if not specs:
            there = ", ".join(sorted({spec.split for spec in self.specs}))
            raise UsageError(
                f"the specs have no episodes in {', '.join(sorted(splits or ()))}; splits of the specs: {there}"
            )
        source = self.source if len(specs) == len(self.specs) else f"{self.source}; {len(specs)} of {len(self.specs)}"
        return SpecSet(source=source, run=self.run, settings=self.settings, specs=tuple(specs))


def spread(count: int, wanted: int | None) -> list[int]:
    """Returns at most `wanted` places of a list of `count`, evenly apart; all of them where none is wanted."""
    if wanted is None or wanted >= count:
        return list(range(count))
    return [number * count // wanted for number in range(wanted)]
