"""Campaign of an evaluation: policies, variants and episodes, and the tasks made from them. Runs no episodes."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from factory.eval.models.messages import Actions, EvalRequest, EvalTask, Setup
from factory.eval.models.result import Variant
from factory.eval.models.spec import SpecSet
from factory.eval.policies import find_policy
from factory.eval.specs.ablation import instructions, playback_sources
from factory.eval.specs.from_dataset import Places
from schemas.bundle import BundleReader
from schemas.errors import ArchiveCorrupt, InvalidBundle, UsageError
from schemas.job import index_of_file
from schemas.storage.shard_index import episode_place


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
    variants: tuple[Variant, ...]
    setup: Setup
    processes: int = 1
    """Number of driver processes on this machine."""
    with_pose: bool = False
    """Whether observations contain the pose in the frame of the start pose."""


def tasks_for(campaign: Campaign, policy: str, places: Places, first: int = 1) -> list[EvalTask]:
    """Returns all tasks of a policy in the order of execution: by variant, scene and position in the set.

    Args:
        campaign: campaign of the policy.
        policy: name of a policy of the campaign.
        places: scenes of the campaign.
        first: number of the first task.
    """
    entry = find_policy(policy)
    specs = campaign.specs
    # a policy that reads no instruction runs the original variant only
    variants = campaign.variants if entry.reads_instruction else (Variant.ORIGINAL,)
    needs_scenes = Variant.WRONG in variants
    scenes = {
        spec.scene_sha256: places.load(spec.scene, spec.scene_sha256).scene.info for spec in specs.specs if needs_scenes
    }
    recorded = _recordings(policy, specs) if entry.needs_recording else {}
    tasks: list[EvalTask] = []
    for variant in variants:
        words = instructions(specs, variant, scenes)
        for spec in sorted(specs.specs, key=lambda spec: spec.scene):
            tasks.append(
                EvalTask(
                    number=first + len(tasks),
                    policy=policy,
                    request=EvalRequest(
                        spec=spec,
                        spec_digest=specs.spec_digest(spec),
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
