"""Model of a plan, which a user writes as TOML: scenes, numbers of episodes, tiers, splits, expert and parameters.

Validates each field and the sum of the shares. Does not check the content of the scenes; plan expansion does.
"""

from __future__ import annotations

import functools
import hashlib
import json
from collections.abc import Mapping
from types import MappingProxyType
from typing import Annotated, Any, Literal, Self

from pydantic import (
    AliasChoices,
    Field,
    SerializerFunctionWrapHandler,
    ValidationInfo,
    field_validator,
    model_serializer,
    model_validator,
)

from schemas.base import Fraction, Model, Name
from schemas.config import (
    CameraConfig,
    DemonstrationConfig,
    ExpertConfig,
    InstructionConfig,
    PlannerConfig,
    RobotConfig,
    SpawnConfig,
    TaskConfig,
)
from schemas.instruction.taxonomy import category_of
from schemas.language.file import LanguageSpec
from schemas.rig.arrays import rig_faults
from schemas.terms import (
    BUILTIN_CATEGORIES,
    CATEGORIES,
    ExpertName,
    Recording,
    SceneCategories,
    Screening,
    Split,
    Tier,
)
from schemas.view import AppearanceData, RigData, ViewSettings

MAX_EPISODES = 9_999_999
PAPER_TIERS = MappingProxyType({Tier.NEAR: 0.3, Tier.MID: 0.4, Tier.FAR: 0.3})
PAPER_SPLITS = MappingProxyType(
    {
        Split.TRAIN_ID: 0.6,
        Split.VAL_ID: 0.1,
        Split.TEST_ID: 0.1,
        Split.TEST_PARAPHRASE_OOD: 0.1,
        Split.TEST_OOD_OBJ: 0.1,
    }
)
_LATER_KEYS = frozenset(
    {"rules", "targets", "allow_outside", "ceiling_m", "tiers", "splits", "ambiguous", "screening"}
    | {"unit", "up", "models"}
)
"""Keys added after the first version; they are omitted from the digest if unused, so that older digests stay valid."""
Shares = Mapping[Tier, float] | Mapping[Split, float]


class ScenePlan(Model):
    """Entry of a plan for one scene."""

    file: str | None = Field(default=None, validation_alias=AliasChoices("file", "usd"))
    """Path of the root file of a custom scene, relative to the plan file; null for a built-in scene. Serialised as
    `usd`, its former name, so that older digests stay valid."""
    name: Name
    """Name of a built-in scene, or the name of a custom scene in the dataset."""
    episodes: Annotated[int, Field(ge=1, le=MAX_EPISODES)]
    """Number of episodes in this scene."""
    seed: Annotated[int, Field(ge=0)] = 0
    """Layout seed of a built-in scene."""
    seen: tuple[Name, ...] = ()
    """Categories of the in-distribution splits; empty selects those of the paper."""
    held_out: tuple[Name, ...] = ()
    """Categories of the split `test_ood_obj` only; empty selects those of the paper."""
    rules: str | None = None
    """Path of a custom table of category rules, relative to the plan file."""
    targets: str | None = None
    """Path of an edited `targets_<scene>.yaml`, relative to the plan file."""
    allow_outside: bool = False
    """Whether files of a custom scene may be stored outside its folder."""
    unit: Literal["m", "cm", "mm", "in"] | None = None
    """Unit of a custom scene; null is the unit that the file states."""
    up: Literal["y", "z"] | None = None
    """Axis of a custom scene that points up; null is the axis that the file states."""
    models: tuple[str, ...] = ()
    """Folders in which `model://` and `package://` names are searched, relative to the plan file."""
    ceiling_m: Annotated[float, Field(ge=1, le=100)] | None = None
    """Height above the floor of a flat ceiling that is added to a custom scene, metres; null adds none."""
    screening: Screening | None = None
    """Selection of the starts in this scene; null selects `spawn.screening` of the plan."""
    ambiguous: tuple[Name, ...] = ()
    """Categories whose instructions may fit several objects, where `instructions.unique` asks for one."""
    tiers: dict[Tier, Fraction] = Field(default_factory=dict)
    """Fraction of episodes in each tier of this scene; empty selects the plan's fractions."""
    splits: dict[Split, Fraction] = Field(default_factory=dict)
    """Fraction of episodes in each split of this scene; empty selects the plan's fractions."""

    @model_serializer(mode="wrap")
    def _leave_out_unused(self, serialize: SerializerFunctionWrapHandler) -> dict[str, object]:
        data: dict[str, object] = serialize(self)
        used = {key: value for key, value in data.items() if value or key not in _LATER_KEYS}
        return {"usd" if key == "file" else key: value for key, value in used.items()}

    @property
    def categories(self) -> SceneCategories:
        """Seen and held-out categories that apply to this scene."""
        table = BUILTIN_CATEGORIES.get(self.name, SceneCategories((), ())) if self.file is None else None
        seen, held_out = table or SceneCategories((), ())
        return SceneCategories(self.seen or seen, self.held_out or held_out)

    @field_validator("name")
    @classmethod
    def _is_a_known_scene(cls, name: str, others: ValidationInfo) -> str:
        if others.data.get("file") is None and name not in BUILTIN_CATEGORIES:
            known = ", ".join(BUILTIN_CATEGORIES)
            raise ValueError(f"not a built-in scene ({known}); for a scene of a file give `file = PATH`")
        return name

    @field_validator("seen", "held_out")
    @classmethod
    def _are_known_categories(cls, categories: tuple[str, ...], others: ValidationInfo) -> tuple[str, ...]:
        scene = others.data.get("name", "")
        known = {*CATEGORIES, *(name for group in BUILTIN_CATEGORIES.get(scene, ()) for name in group)}
        unknown = [name for name in categories if name not in known]
        if unknown and others.data.get("file") is None:
            meant = {name: category_of(name) for name in unknown}
            hints = [f"{name} is a synonym of {found}" for name, found in meant.items() if found in known]
            text = f"unknown categories {', '.join(unknown)}; categories of {scene}: {', '.join(sorted(known))}"
            raise ValueError("; ".join([text, *hints]))
        return categories

    @field_validator("ceiling_m")
    @classmethod
    def _is_for_a_stage(cls, ceiling_m: float | None, others: ValidationInfo) -> float | None:
        if ceiling_m is not None and others.data.get("file") is None:
            raise ValueError("a built-in scene has a ceiling; `ceiling_m` is for a scene of a file (`file = PATH`)")
        return ceiling_m

    @model_validator(mode="after")
    def _categories_make_sense(self) -> ScenePlan:
        seen, held_out = self.categories
        both = sorted(set(seen) & set(held_out))
        if both:
            raise ValueError(f"categories both seen and held out: {', '.join(both)}")
        unnamed = sorted(set(self.ambiguous) - {*seen, *held_out})
        if unnamed:
            raise ValueError(f"`ambiguous` lists categories that are neither seen nor held out: {', '.join(unnamed)}")
        if not seen:
            raise ValueError("a scene with `file` needs `seen = [...]`, the categories to train on")
        return self


class Budget(Model):
    """Limits on the attempts for one episode (docs/design/jobs.md#draws-and-budgets)."""

    attempts_per_draw: Annotated[int, Field(ge=1, le=1000)] = 6
    """Number of task failures after which target and template are drawn again."""
    draws: Annotated[int, Field(ge=1, le=1000)] = 40
    """Number of draws after which the episode has failed."""
    crashes: Annotated[int, Field(ge=1, le=100)] = 3
    """Number of worker processes that a job may crash before it is quarantined."""


class Plan(Model):
    """Plan of a run; its digest is part of the name of the run."""

    name: Name
    """Name of the plan."""
    seed: Annotated[int, Field(ge=0, lt=2**63)] = 42
    """Root seed of the run."""
    scenes: Annotated[tuple[ScenePlan, ...], Field(min_length=1)]
    """Scenes of the run."""
    tiers: dict[Tier, Fraction] = Field(default_factory=lambda: dict(PAPER_TIERS))
    """Fraction of episodes in each tier."""
    splits: dict[Split, Fraction] = Field(default_factory=lambda: dict(PAPER_SPLITS))
    """Fraction of episodes in each split."""
    expert: ExpertName = ExpertName.PROPORTIONAL
    """Controller that drives."""
    record: Recording = Field(default=Recording.FRAMES, exclude_if=lambda it: it is Recording.FRAMES)
    """What an episode stores; omitted for frames, so that former digests stay valid."""
    rig: RigData | None = Field(default=None, exclude_if=lambda rig: rig is None)
    """Sensors that a recording of frames stores, beside the recorded camera, and the default rig of readers of a
    recording of states; null and omitted for none."""
    appearance: AppearanceData | None = Field(default=None, exclude_if=lambda it: it is None)
    """Ranges of the appearance of the frames of a recording of frames, and default appearance of readers of a recording
    of states; null and omitted for none."""
    colors: Literal["on", "off"] = "on"
    """Whether instructions may name colours; `off` is the paper's v1: every colour unknown, no colour templates."""
    balance: Literal["instances", "categories", "categories_overall"] = "instances"
    """Even choice over the target instances (as in the paper), over the categories of each scene first, or over the
    categories of all scenes first."""
    disjoint_instances: bool = False
    """Whether training and the evaluation of seen categories use different instances if a scene has enough of them."""
    instructions: InstructionConfig = Field(
        default=InstructionConfig(), exclude_if=lambda wanted: wanted == InstructionConfig()
    )
    """Parameters of the instructions; omitted if they are the defaults."""
    language: LanguageSpec | None = Field(default=None, exclude_if=lambda it: it is None)
    """Verified instructions, which workers write at the start; null and omitted for the templates."""
    budget: Budget = Budget()
    """Limits on the attempts for one episode."""
    task: TaskConfig = TaskConfig()
    """Parameters of the task."""
    robot: RobotConfig = RobotConfig()
    """Parameters of the robot."""
    camera: CameraConfig = CameraConfig()
    """Parameters of the camera."""
    spawn: SpawnConfig = SpawnConfig()
    """Parameters of the spawn."""
    gains: ExpertConfig = ExpertConfig()
    """Gains of the proportional controller."""
    planner: PlannerConfig = PlannerConfig()
    """Parameters of the planner expert."""
    demonstration: DemonstrationConfig = Field(
        default=DemonstrationConfig(), exclude_if=lambda wanted: wanted == DemonstrationConfig()
    )
    """Requirements on a demonstration; omitted if there are none."""

    @model_serializer(mode="wrap")
    def _leave_out_unused(self, serialize: SerializerFunctionWrapHandler) -> dict[str, object]:
        data: dict[str, object] = serialize(self)
        return data if data.get("disjoint_instances") else {k: v for k, v in data.items() if k != "disjoint_instances"}

    @model_validator(mode="after")
    def _adds_up(self) -> Plan:
        listed: list[tuple[str, Shares]] = [("tiers", self.tiers), ("splits", self.splits)]
        for number, scene in enumerate(self.scenes):
            own: list[tuple[str, Shares]] = [("tiers", scene.tiers), ("splits", scene.splits)]
            listed += [(f"scenes[{number}].{key}", shares) for key, shares in own if shares]
        mistakes = [
            f"{key}: the shares add up to {sum(shares.values()):g}, not 1"
            for key, shares in listed
            if abs(sum(shares.values()) - 1) > 1e-6
        ]
        names = [scene.name for scene in self.scenes]
        mistakes += [f"scenes: {name!r} is listed twice" for name in sorted({n for n in names if names.count(n) > 1})]
        mistakes += [
            f"scenes: {scene.name!r} has no held-out category, but splits.test_ood_obj is above 0"
            for scene in self.scenes
            if self.splits_of(scene).get(Split.TEST_OOD_OBJ, 0) > 0 and not scene.categories.held_out
        ]
        if sum(scene.episodes for scene in self.scenes) > MAX_EPISODES:
            mistakes.append(f"scenes: more than {MAX_EPISODES} episodes")
        if self.language is None and any(self.splits_of(scene).get(Split.TEST_FALSE_PREMISE) for scene in self.scenes):
            mistakes.append(
                "splits.test_false_premise: the templates have no false premises, the table [language] has them"
            )
        if self.language is not None:
            mistakes += _language_faults(self.language, self.instructions)
        if self.rig is not None:
            mistakes += rig_faults(self.rig, self.task.control_hz, self.task.max_steps)
        if mistakes:
            raise ValueError("; ".join(mistakes))
        return self

    def tiers_of(self, scene: ScenePlan) -> Mapping[Tier, float]:
        """Returns the fractions of tiers that apply to a scene."""
        return scene.tiers or self.tiers

    def splits_of(self, scene: ScenePlan) -> Mapping[Split, float]:
        """Returns the fractions of splits that apply to a scene."""
        return scene.splits or self.splits

    def spawn_of(self, scene: str) -> SpawnConfig:
        """Returns the parameters of the spawn that apply to the scene of that name."""
        screening = next(part.screening for part in self.scenes if part.name == scene)
        return self.spawn if screening is None else self.spawn.model_copy(update={"screening": screening})

    @property
    def screening(self) -> str:
        """Selection of the starts, with the scenes in which another one applies: `none, office sight`."""
        others = [f"{scene.name} {scene.screening}" for scene in self.scenes if scene.screening]
        return ", ".join([self.spawn.screening, *others])

    def tier_share(self, tier: Tier) -> float:
        """Returns the requested fraction of all episodes in a tier, over all scenes."""
        return sum(scene.episodes * self.tiers_of(scene).get(tier, 0.0) for scene in self.scenes) / self.episodes

    def split_share(self, split: Split) -> float:
        """Returns the requested fraction of all episodes in a split, over all scenes."""
        return sum(scene.episodes * self.splits_of(scene).get(split, 0.0) for scene in self.scenes) / self.episodes

    @property
    def view(self) -> ViewSettings:
        """What the episodes are rendered with."""
        return ViewSettings(rig=self.rig, appearance=self.appearance)

    @property
    def episodes(self) -> int:
        """Number of episodes over all scenes."""
        return sum(scene.episodes for scene in self.scenes)

    @functools.cached_property
    def digest(self) -> str:
        """SHA-256 of the canonical JSON of the plan; plans with equal digests describe the same dataset."""
        # cached, because every claimed job needs it; parsed again, so that 1 and 1.0 give one digest
        text = canonical_json(Plan.model_validate_json(self.model_dump_json()))
        return hashlib.sha256(text.encode()).hexdigest()

    def model_copy(self, *, update: Mapping[str, Any] | None = None, deep: bool = False) -> Self:
        """Returns a copy with other values, without the cached digest."""
        copy = super().model_copy(update=update, deep=deep)
        copy.__dict__.pop("digest", None)
        return copy

    @property
    def run(self) -> str:
        """Name of the run in keys and records."""
        return f"{self.name}-{self.digest[:8]}"


def _language_faults(language: LanguageSpec, others: InstructionConfig) -> list[str]:
    """Returns the keys of a language block that a plan does not support."""
    found = []
    if language.per_episode != 1:
        found.append("language.per_episode: an episode of a plan has one instruction, `factory relabel` writes several")
    if language.false_premises:
        found.append("language.false_premises: a plan has a split for them, set splits.test_false_premise")
    if others.unique != "off":
        found.append("instructions.unique is for templates, remove it: `language` has `fit`")
    return found


def canonical_json(model: Model, exclude: set[str] | dict[str, Any] | None = None) -> str:
    """Returns the model as JSON with sorted keys and no spaces, suitable for hashing.

    Args:
        model: model to write.
        exclude: fields to leave out, as pydantic's `model_dump` takes them.
    """
    data = model.model_dump(mode="json", exclude=exclude)
    return json.dumps(data, sort_keys=True, separators=(",", ":"), ensure_ascii=False, allow_nan=False)
