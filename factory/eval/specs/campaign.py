"""What a campaign asks: its policies, variants and episodes, and the tasks that come of them. Drives nothing."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from factory.eval.models.messages import EvalTask, Setup
from factory.eval.models.request import EvalRequest
from factory.eval.models.result import Variant
from factory.eval.models.spec import SpecSet
from factory.eval.policies import find_policy
from factory.eval.specs.ablation import donors, instructions
from factory.eval.specs.from_dataset import Places
from factory.eval.specs.recordings import read_actions_of
from schemas.errors import UsageError

__all__ = ["Campaign", "require_recordings", "tasks_for", "with_actions"]


@dataclass(frozen=True)
class Campaign:
    """What to evaluate, and with what."""

    specs: SpecSet
    root: Path
    """The dataset, which has the scenes."""
    policies: tuple[str, ...]
    variants: tuple[Variant, ...]
    setup: Setup
    processes: int = 1
    """Driving processes on this machine."""
    with_pose: bool = False
    """Whether policies are given the pose in the frame of the start."""


def tasks_for(campaign: Campaign, policy: str, places: Places, first: int = 1) -> list[EvalTask]:
    """Returns all tasks of a policy in the order of work: by variant, scene and place in the set.

    Args:
        campaign: what to evaluate.
        policy: one of the campaign's.
        places: its scenes.
        first: number of the first task.
    """
    entry = find_policy(policy)
    specs = campaign.specs
    # a policy that cannot hear is not asked again under other words
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
    """Returns the task with the actions of the episode that its request names, where it names one.

    Raises:
        ArchiveCorrupt: the dataset lacks the episode.
    """
    recorded = task.request.recorded
    return task if recorded is None else task.model_copy(update={"actions": read_actions_of(root, recorded)})


def require_recordings(policy: str, specs: SpecSet) -> None:
    """Makes sure that all specs come from archived episodes.

    Raises:
        UsageError: one does not.
    """
    lacking = [spec.spec_id for spec in specs.specs if spec.source_episode is None]
    if lacking:
        raise UsageError(f"policy {policy} needs specs of archived episodes; {lacking[0]} was newly sampled")


def _recordings(policy: str, specs: SpecSet) -> dict[str, str]:
    require_recordings(policy, specs)
    if policy == "playback":
        return donors(specs)
    return {spec.spec_id: spec.source_episode for spec in specs.specs if spec.source_episode is not None}
