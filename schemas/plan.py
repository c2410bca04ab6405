"""Model of a plan, which a user writes as TOML: scenes, numbers of episodes, tiers, splits, expert and parameters.

Validates each field and the sum of the shares. Does not check the content of the scenes; plan expansion does.
"""

from __future__ import annotations

import functools
import hashlib
import itertools
import json
from collections.abc import Mapping
from types import MappingProxyType
from typing import Annotated, Any, Literal, Self

from pydantic import (
    Field,
    SerializerFunctionWrapHandler,
    model_serializer,
    model_validator,
)

from schemas.base import Fraction, Model, Name
from schemas.config import (
    CameraConfig,
    CorrectionConfig,
    DemonstrationConfig,
    ExpertConfig,
    InstructionConfig,
    PlannerConfig,
    RobotConfig,
    SpawnConfig,
    TaskConfig,
)
from schemas.language.language_file import LanguageSpec
from schemas.layouts import layout_mistakes, layouts_of
from schemas.rig.arrays import rig_faults
from schemas.scene_plan import MAX_EPISODES as MAX_EPISODES
from schemas.scene_plan import ScenePlan as ScenePlan
from schemas.terms import (
    ExpertName,
    Recording,
    Split,
    Tier,
)
from schemas.view import AppearanceData, RigData, ViewSettings

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
_MAX_EXTENDED_CHARS = 1 << 26
Shares = Mapping[Tier, float] | Mapping[Split, float]


class Budget(Model):
    """Limits on the attempts for one episode (docs/design/jobs.md#draws-and-budgets).

    More attempts per draw keep targets that are hard to reach; fewer attempts leave impossible targets sooner. With the
    defaults, an episode has 240 attempts. If one attempt in ten succeeds, the lowest rate that was measured (far starts
    in the office), all of them fail with a probability of 1e-11.
    """

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
    """Content that an episode stores; omitted for frames, so older digests stay valid."""
    rig: RigData | None = Field(default=None, exclude_if=lambda rig: rig is None)
    """Sensors that a recording of frames stores in addition to the recorded camera, and the default rig of readers of a
    recording of states; null and omitted for none."""
    appearance: AppearanceData | None = Field(default=None, exclude_if=lambda it: it is None)
    """Ranges from which the appearance of recorded frames is drawn. For a recording of states, readers draw from them
    by default. Null and omitted for none."""
    colors: Literal["on", "off"] = "on"
    """Whether instructions may name colours; with `off`, as in the published data, every colour is unknown and no
    template names a colour."""
    balance: Literal["instances", "categories", "categories_overall"] = "instances"
    """What occurs equally often: target instances, as in the paper; the categories of each scene, then their instances;
    or the categories of all scenes together, then their instances."""
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
    correction: CorrectionConfig | None = Field(default=None, exclude_if=lambda it: it is None)
    """Policy whose episodes the planner corrects; only `factory correct` sets it. Null and omitted for others."""
    extends: Annotated[str, Field(max_length=_MAX_EXTENDED_CHARS)] | None = Field(
        default=None, exclude_if=lambda it: it is None
    )
    """Plan, as JSON, whose assignment of instances to training and evaluation applies; only `factory run --extend` sets
    it, for plans with `disjoint_instances`. Null and omitted for others."""

    @model_serializer(mode="wrap")
    def _leave_out_unused(self, serialize: SerializerFunctionWrapHandler) -> dict[str, object]:
        data: dict[str, object] = serialize(self)
        return data if data.get("disjoint_instances") else {k: v for k, v in data.items() if k != "disjoint_instances"}

    @model_validator(mode="after")
    def _adds_up(self) -> Plan:
        listed: list[tuple[str, Shares]] = [("tiers", self.tiers), ("splits", self.splits)]
        for number, scene in enumerate(self.scenes):
            shares_of_key: list[tuple[str, Shares]] = [("tiers", scene.tiers), ("splits", scene.splits)]
            listed += [(f"scenes[{number}].{key}", shares) for key, shares in shares_of_key if shares]
        mistakes = [
            f"{key}: the shares add up to {sum(shares.values()):g}, not 1"
            for key, shares in listed
            if abs(sum(shares.values()) - 1) > 1e-6
        ]
        names = [scene.name for scene in self.scenes]
        mistakes += [f"scenes: {name!r} is listed twice" for name in sorted({n for n in names if names.count(n) > 1})]
        mistakes += [
            f"scenes: {scene.name!r} has no held-out category, but splits.{split} is above 0: give `held_out`, or set "
            f"splits.{split} to 0"
            for scene in self.scenes
            if not scene.categories.held_out
            for split, share in self.splits_of(scene).items()
            if split.is_held_out and share > 0
        ]
        for number, scene in enumerate(self.scenes):
            faults = layout_mistakes(scene, self.splits_of(scene))
            mistakes += [f"scenes[{number}] {scene.name}: {fault}" for fault in faults]
        if sum(scene.episodes for scene in self.scenes) > MAX_EPISODES:
            mistakes.append(f"scenes: more than {MAX_EPISODES} episodes")
        if self.language is None and any(self.splits_of(scene).get(Split.TEST_FALSE_PREMISE) for scene in self.scenes):
            mistakes.append(
                "splits.test_false_premise needs the table [language], because templates have no false premises"
            )
        if self.language is not None:
            mistakes += _language_faults(self, self.language)
        if self.correction is not None and self.expert is not ExpertName.PLANNER:
            mistakes.append(f'correction: the expert {self.expert} has no action for any pose: set expert = "planner"')
        if self.rig is not None:
            mistakes += rig_faults(self.rig, self.task.control_hz, self.task.max_steps)
        if self.extends is not None:
            mistakes += [f"extends: no scene {name!r}" for name in names if name not in self.extended_scenes]
        if mistakes:
            raise ValueError("\n".join(mistakes))
        return self

    @functools.cached_property
    def extended(self) -> Plan | None:
        """Plan of `extends`."""
        return None if self.extends is None else Plan.model_validate_json(self.extends)

    @property
    def extended_scenes(self) -> frozenset[str]:
        """Names of the entries of the plan of `extends`."""
        return frozenset() if self.extended is None else frozenset(scene.name for scene in self.extended.scenes)

    def tiers_of(self, scene: ScenePlan) -> Mapping[Tier, float]:
        """Returns the fractions of tiers that apply to a scene."""
        return scene.tiers or self.tiers

    def splits_of(self, scene: ScenePlan) -> Mapping[Split, float]:
        """Returns the fractions of splits that apply to a scene."""
        return scene.splits or self.splits

    def spawn_of(self, scene: str) -> SpawnConfig:
        """Returns the parameters of the spawn that apply to the scene of that name."""
        screening = self.part(scene).screening
        return self.spawn if screening is None else self.spawn.model_copy(update={"screening": screening})

    @property
    def screening(self) -> str:
        """Selection of the starts, followed by the scenes with another selection, such as `none, office sight`."""
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
        """Rendering settings of the episodes."""
        return ViewSettings(rig=self.rig, appearance=self.appearance)

    @property
    def episodes(self) -> int:
        """Number of episodes over all scenes."""
        return sum(scene.episodes for scene in self.scenes)

    @functools.cached_property
    def parts(self) -> tuple[ScenePlan, ...]:
        """Entries of single scenes: `scenes`, in which the layouts of a family replace its entry."""
        return tuple(
            part
            for scene in self.scenes
            for part in (layouts_of(scene, self.splits_of(scene), self.tiers_of(scene)) if scene.layouts else (scene,))
        )

    @functools.cached_property
    def _parts_by_name(self) -> Mapping[str, ScenePlan]:
        return {part.name: part for part in self.parts}

    def part(self, name: str) -> ScenePlan:
        """Returns the entry of a single scene.

        Raises:
            KeyError: the plan has no such scene.
        """
        return self._parts_by_name[name]

    @functools.cached_property
    def spans(self) -> Mapping[str, range]:
        """Numbers of the episodes of each entry of `parts`, by name."""
        ends = tuple(itertools.accumulate((part.episodes for part in self.parts), initial=1))
        return {part.name: range(*span) for part, span in zip(self.parts, itertools.pairwise(ends), strict=True)}

    @functools.cached_property
    def digest(self) -> str:
        """SHA-256 of the canonical JSON of the plan; plans with equal digests describe the same dataset."""
        # cached, because every claimed job needs it; parsing the JSON makes 1 and 1.0 in a float field equal
        text = canonical_json(Plan.model_validate_json(self.model_dump_json()))
        return hashlib.sha256(text.encode()).hexdigest()

    def model_copy(self, *, update: Mapping[str, Any] | None = None, deep: bool = False) -> Self:
        """Returns a copy with changed values, which does not contain the cached values of the original."""
        copy = super().model_copy(update=update, deep=deep)
        for name in ("digest", "parts", "spans", "_parts_by_name", "extended"):
            copy.__dict__.pop(name, None)
        return copy

    @property
    def run(self) -> str:
        """Name of the run in keys and records."""
        return f"{self.name}-{self.digest[:8]}"


def _language_faults(plan: Plan, language: LanguageSpec) -> list[str]:
    """Returns a message for each key of a language block that a plan does not support."""
    findings = []
    if language.per_episode != 1:
        findings.append(
            "language.per_episode: an episode of a plan has one instruction, `factory relabel` writes several"
        )
    if language.false_premises:
        findings.append("language.false_premises: a plan has a split for them, set splits.test_false_premise")
    if plan.instructions.unique != "off":
        findings.append("instructions.unique is for templates, remove it; use `language.fit` instead")
    if language.exchangeable:
        findings += _exchange_faults(plan)
    return findings


def _exchange_faults(plan: Plan) -> list[str]:
    """Returns a message for each key of a plan that prevents drawing the target at the start."""
    findings = []
    if plan.expert is not ExpertName.PLANNER:
        findings.append(
            f"language.exchangeable: the expert {plan.expert} drives straight, so few objects in view could be "
            'the target: set expert = "planner"'
        )
    if any(plan.tiers_of(scene).get(Tier.FAR) for scene in plan.scenes):
        findings.append("language.exchangeable: the image does not show distances along the floor: set tiers.far to 0")
    if plan.colors == "off":
        findings.append(
            "language.exchangeable: `colors` is for templates, remove it "
            "(to exclude colours, set colour = 0 in [language.features])"
        )
    return findings


def canonical_json(model: Model, exclude: set[str] | dict[str, Any] | None = None) -> str:
    """Returns the model as JSON with sorted keys and no spaces, suitable for hashing.

    Args:
        model: model to write.
        exclude: fields to omit, as pydantic's `model_dump` takes them.
    """
    data = model.model_dump(mode="json", exclude=exclude)
    return json.dumps(data, sort_keys=True, separators=(",", ":"), ensure_ascii=False, allow_nan=False)
