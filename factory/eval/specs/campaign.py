"""Campaign of an evaluation: policies, instruction variants and episodes, and the tasks made from them.

The variants of the language ablation are shuffled, wrong category and empty: a policy that succeeds equally often with
wrong instructions does not use them (paper Sec. VII). Runs no episodes.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from factory.eval.models.messages import Actions, EvalRequest, EvalSetup, EvalTask
from factory.eval.models.result import Variant
from factory.eval.models.spec import EvalSpec, SpecSet
from factory.eval.policies.registry import find_policy
from factory.eval.specs.from_dataset import LoadedScenes
from schemas.bundle import BundleReader
from schemas.errors import ArchiveCorrupt, InvalidBundle, UsageError
from schemas.instruction.templates import TEMPLATES, instruction, needs_colour
from schemas.job import index_of_file
from schemas.scene import SceneInfo
from schemas.storage.shard_index import episode_place

ABLATIONS = (Variant.SHUFFLED, Variant.WRONG, Variant.EMPTY)
_WRONG_STREAM, _SHUFFLE_STREAM, _DONOR_STREAM = 11, 12, 13

Scenes = Mapping[str, SceneInfo]
"""SHA-256 of a scene package -> its contents."""


def instructions(specs: SpecSet, variant: Variant, scenes: Scenes) -> dict[str, str]:
    """Returns the instruction of each spec under a variant, by spec id; deterministic for a spec set.

    Args:
        specs: Spec set.
        variant: Instruction variant.
        scenes: Scenes of the set, for their categories.

    Raises:
        UsageError: All instructions of the set are equal, or a scene has only one category.
    """
    if variant is Variant.SHUFFLED:
        return _shuffled(specs)
    if variant is Variant.WRONG:
        return {spec.spec_id: _wrong(spec, scenes[spec.scene_sha256]) for spec in specs.specs}
    if variant is Variant.EMPTY:
        return {spec.spec_id: "" for spec in specs.specs}
    return {spec.spec_id: spec.instruction for spec in specs.specs}


def playback_sources(specs: SpecSet) -> dict[str, str]:
    """Returns for each spec id the id of another archived episode, whose actions the policy `playback` executes.

    Raises:
        UsageError: Fewer than two archived episodes are in the set.
    """
    recorded = [spec for spec in specs.specs if spec.source_episode is not None]
    if len({spec.source_episode for spec in recorded}) < 2:
        raise UsageError(
            "policy playback needs specs of at least two archived episodes; increase --episodes, or add a --split"
        )
    rng = np.random.default_rng(np.random.SeedSequence((int(specs.digest[:8], 16), _DONOR_STREAM)))
    ring = [recorded[int(number)] for number in rng.permutation(len(recorded))]
    sources: dict[str, str] = {}
    for place, spec in enumerate(ring):
        others = (ring[(place + step) % len(ring)].source_episode for step in range(1, len(ring)))
        sources[spec.spec_id] = next(name for name in others if name is not None and name != spec.source_episode)
    return sources


def _shuffled(specs: SpecSet) -> dict[str, str]:
    if len({spec.instruction for spec in specs.specs}) < 2:
        raise UsageError(
            "all episodes have the same instruction, so it cannot be shuffled; increase --episodes, or add a --split"
        )
    rng = np.random.default_rng(np.random.SeedSequence((int(specs.digest[:8], 16), _SHUFFLE_STREAM)))
    ring = [specs.specs[int(number)] for number in rng.permutation(len(specs.specs))]
    shuffled: dict[str, str] = {}
    for place, spec in enumerate(ring):
        others = (ring[(place + step) % len(ring)].instruction for step in range(1, len(ring)))
        shuffled[spec.spec_id] = next(words for words in others if words != spec.instruction)
    return shuffled


def _wrong(spec: EvalSpec, scene: SceneInfo) -> str:
    """Returns the template with another category, preferably one in view at the start."""
    there = sorted({target.category for target in scene.targets} - {spec.category})
    if not there:
        raise UsageError(
            f"scene {spec.scene} has targets of category {spec.category} only, so there is no wrong category"
        )
    rng = np.random.default_rng(np.random.SeedSequence((spec.seed, _WRONG_STREAM)))
    in_view = [category for category in there if category in spec.categories_in_view]
    category = str(rng.choice(in_view or there))
    if spec.template_id not in TEMPLATES:
        raise UsageError(
            f"{spec.spec_id}: {spec.template_id!r} is not a template, so its category cannot be changed; omit the "
            "variant `wrong` (`shuffled` gives other instructions)"
        )
    return instruction(spec.template_id, category, _colour(spec, scene, category, rng))


def _colour(spec: EvalSpec, scene: SceneInfo, category: str, rng: np.random.Generator) -> str:
    if not needs_colour(spec.template_id):
        return spec.colour
    known = [target.colour for target in scene.targets if target.category == category and target.colour != "unknown"]
    return str(rng.choice(sorted(known))) if known else spec.colour


def read_actions_of(root: Path, episode: str) -> Actions:
    """Returns the recorded commands of an episode.

    Args:
        root: Dataset directory.
        episode: Episode id.

    Raises:
        ArchiveCorrupt: The episode is missing or damaged.
    """
    path = episode_place(root, index_of_file(f"{episode}.zip") or 0)
    try:
        with path.open("rb") as file:
            commands = BundleReader(file).arrays.actions_continuous
    except FileNotFoundError as error:
        raise ArchiveCorrupt(f"{path} is missing: run `factory verify`") from error
    except InvalidBundle as error:
        raise ArchiveCorrupt(f"{path} is damaged ({'; '.join(error.findings)}): run `factory verify --deep`") from error
    return tuple((float(v), float(w)) for v, w in commands)


@dataclass(frozen=True)
class Campaign:
    """Campaign: specs, policies, instruction variants and settings of an evaluation."""

    specs: SpecSet
    root: Path
    """Dataset directory with the scenes."""
    policies: tuple[str, ...]
    """Names of the policies in the results."""
    variants: tuple[Variant, ...]
    setup: EvalSetup
    processes: int = 1
    """Number of driver processes on this machine."""
    with_pose: bool = False
    """Whether observations contain the pose in the frame of the start pose."""
    references: Mapping[str, str] = field(default_factory=dict)
    """Name of a policy -> what it refers to; a policy that is not listed refers to itself."""

    def reference(self, policy: str) -> str:
        """Returns what the name of a policy refers to."""
        return self.references.get(policy, policy)


def tasks_for(campaign: Campaign, policy: str, places: LoadedScenes, first: int = 1) -> list[EvalTask]:
    """Returns all tasks of a policy in the order of execution: by variant, scene and position in the set.

    Args:
        campaign: campaign of the policy.
        policy: name of a policy of the campaign.
        places: scenes of the campaign.
        first: number of the first task.
    """
    reference = campaign.reference(policy)
    entry = find_policy(reference)
    specs = campaign.specs
    # a policy that reads no instruction runs the original variant only; its language gap is 0 by construction
    variants = campaign.variants if entry.reads_instruction else (Variant.ORIGINAL,)
    needs_scenes = Variant.WRONG in variants
    scenes = {
        spec.scene_sha256: places.load(spec.scene, spec.scene_sha256).compiled.info
        for spec in specs.specs
        if needs_scenes
    }
    recorded = _recordings(reference, specs) if entry.needs_recording else {}
    tasks: list[EvalTask] = []
    for variant in variants:
        words = instructions(specs, variant, scenes)
        for spec in sorted(specs.specs, key=lambda spec: spec.scene):
            tasks.append(
                EvalTask(
                    number=first + len(tasks),
                    policy=policy,
                    reference=reference,
                    request=EvalRequest(
                        spec=spec,
                        spec_digest=specs.spec_digest(spec, campaign.setup.latency),
                        instruction=words[spec.spec_id],
                        variant=variant,
                        recorded=recorded.get(spec.spec_id),
                        with_pose=campaign.with_pose,
                    ),
                    setup=campaign.setup,
                )
            )
    return tasks


def with_actions(task: EvalTask, root: Path) -> EvalTask:
    """Returns the task; if its request names an archived episode, adds the actions of this episode.

    Raises:
        ArchiveCorrupt: the dataset does not have the episode.
    """
    recorded = task.request.recorded
    return task if recorded is None else task.model_copy(update={"actions": read_actions_of(root, recorded)})


def require_recordings(policy: str, specs: SpecSet) -> None:
    """Raises an error unless all specs come from archived episodes.

    Raises:
        UsageError: A spec does not come from an archived episode.
    """
    lacking = [spec.spec_id for spec in specs.specs if spec.source_episode is None]
    if lacking:
        raise UsageError(f"policy {policy} needs specs of archived episodes; {lacking[0]} was newly sampled")


def _recordings(policy: str, specs: SpecSet) -> dict[str, str]:
    require_recordings(policy, specs)
    if policy == "playback":
        return playback_sources(specs)
    return {spec.spec_id: spec.source_episode for spec in specs.specs if spec.source_episode is not None}
