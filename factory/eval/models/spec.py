"""Models of evaluation episodes: start pose, instruction, target and settings, and their JSON file.

The same spec set gives the same results with the same policy and software.
"""

from __future__ import annotations

import hashlib
import json
from pathlib import Path
from typing import Annotated, Literal

from pydantic import Field, ValidationError, model_validator

from schemas.base import Model, Name, NonNegative, Sha256
from schemas.config import CameraConfig, ExpertConfig, PlannerConfig, RobotConfig, SpawnConfig, TaskConfig
from schemas.episode_spec import EpisodeSpec
from schemas.errors import UsageError
from schemas.job import Job
from schemas.plan import Plan, canonical_json
from schemas.storage.disk import replacing
from schemas.terms import ExpertName, Split

SPECS_FORMAT = 1
"""Format version of the file of specs. Readers accept this version and older ones; a newer one raises an error."""
_NO_PLAN = "0" * 64
_MOST_BYTES = 1 << 30


class EvalSettings(Model):
    """Settings shared by all episodes of a set, equal to those of data collection."""

    task: TaskConfig = TaskConfig()
    """Rules of success, collision and timeout; `max_steps` is the step limit of an episode."""
    robot: RobotConfig = RobotConfig()
    camera: CameraConfig = CameraConfig()
    spawn: SpawnConfig = SpawnConfig()
    gains: ExpertConfig = ExpertConfig()
    """Settings of the experts, and the minimum mask size of an object in view."""
    planner: PlannerConfig = PlannerConfig()

    @classmethod
    def of(cls, source: Plan | Job) -> EvalSettings:
        return cls(**{name: getattr(source, name) for name in cls.model_fields})


class EvalSpec(EpisodeSpec):
    """One episode to be driven."""

    spec_id: Name
    """Unique within its set."""
    scene_sha256: Sha256
    """Digest of the compiled package."""
    seed: Annotated[int, Field(ge=0, lt=2**32)]
    """Random seed for the policy; the simulation is deterministic."""
    spawn_pose: tuple[float, float, float]
    """Pose of base_link before the warm-up steps: x, y in metres, yaw in radians."""
    spawn_source: Literal["job", "frame", "drawn"]
    """`job`: exactly the pose drawn in the data collection. `frame`: pose at frame 0 of the archived episode, because
    this version of the software draws another pose for its job. `drawn`: new pose, drawn for this set."""
    spawn_dist_m: NonNegative
    """Planar distance from the start pose to the target by the success measure, metres."""
    geodesic_m: NonNegative | None
    """Geodesic distance to the success region, metres, which is l in SPL; `None` without a path."""
    categories_in_view: tuple[Name, ...]
    """Categories with an object in view at the start, sorted by name."""
    is_target_in_view: bool
    """Whether the target is in view at the start."""
    source_episode: Name | None = None
    """Archived episode from which the spec was created."""

    def job(self, settings: EvalSettings, expert: ExpertName = ExpertName.PROPORTIONAL) -> Job:
        """Returns the spec as a job, the input of simulation and experts."""
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
    """Content of a file of specs."""

    format: int = SPECS_FORMAT
    source: str
    """Description of the origin of the specs."""
    run: str
    """Run name of the dataset with the scenes."""
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
        """SHA-256 of settings and specs, which determine the results."""
        return hashlib.sha256(canonical_json(self, exclude={"source", "run"}).encode()).hexdigest()

    def spec_digest(self, spec: EvalSpec, latency: float | str | None = None) -> str:
        """Returns the SHA-256 of a spec with the settings; results with equal digests are comparable.

        Args:
            spec: Spec of the set.
            latency: Latency of the policies, which results have to share; `None` without one.
        """
        text = canonical_json(self.settings) + canonical_json(spec) + ("" if latency is None else f"latency {latency}")
        return hashlib.sha256(text.encode()).hexdigest()

    def only(self, splits: frozenset[Split] | None = None, episodes: int | None = None) -> SpecSet:
        """Returns at most `episodes` of the specs of some splits, evenly spaced in the list.

        Raises:
            UsageError: No spec matches.
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
    """Returns at most `wanted` indices of a list of `count` elements, evenly spread; all if `wanted` is `None`."""
    if wanted is None or wanted >= count:
        return list(range(count))
    return [number * count // wanted for number in range(wanted)]


def read_specs(path: Path) -> SpecSet:
    """Reads a file of specs.

    Raises:
        UsageError: The file does not exist, is not a file of specs, or its format is newer than this software.
    """
    try:
        if path.stat().st_size > _MOST_BYTES:
            raise UsageError(f"{path} is larger than {_MOST_BYTES >> 20} MiB, so it is not a specs file")
        text = path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise UsageError(f"{path} cannot be read ({error}); create a specs file with `factory eval specs`") from error
    _refuse_newer(path, text)
    try:
        return SpecSet.model_validate_json(text)
    except ValidationError as error:
        first = error.errors()[0]
        where = ".".join(map(str, first["loc"])) or "the beginning"
        raise UsageError(f"{path} is not a valid specs file: at {where}: {first['msg']}") from error


def write_specs(specs: SpecSet, path: Path) -> None:
    """Writes a file of specs atomically.

    Raises:
        WorldError: The file cannot be written.
    """
    with replacing(path) as part:
        part.write_text(specs.model_dump_json(indent=1) + "\n", encoding="utf-8")


def _refuse_newer(path: Path, text: str) -> None:
    try:
        content = json.loads(text)
    except (ValueError, RecursionError):
        return
    version = content.get("format") if isinstance(content, dict) else None
    if isinstance(version, int) and version > SPECS_FORMAT:
        raise UsageError(
            f"{path} has format {version}, this software reads formats up to {SPECS_FORMAT}: upgrade minivla-factory"
        )
