"""Describes a campaign as a run of evaluation tasks: plan, scenes and jobs. Reads the dataset, writes nothing."""

from __future__ import annotations

import hashlib
from collections import Counter
from collections.abc import Mapping
from pathlib import Path

from coordinator.expansion.catalog import Catalog, SceneEntry, read_entry
from coordinator.expansion.draw import PlannedJob
from factory.eval.models.messages import EvalTask
from factory.eval.policies.registry import file_of
from factory.eval.specs.campaign import Campaign, tasks_for
from factory.eval.specs.from_dataset import LoadedScenes
from schemas.episode_spec import EpisodeSpec
from schemas.errors import UsageError
from schemas.layouts import LayoutPlan
from schemas.plan import Budget, Plan, canonical_json
from schemas.protocol.keys import EVALUATION_PREFIX
from schemas.protocol.messages import MAX_ATTACHMENT_BYTES, Attachment

Attached = Mapping[str, tuple[Attachment, Path]]
"""Policy name -> attachment and path of its file."""
_BUDGET = Budget(attempts_per_draw=1, draws=1)
"""Each task has one attempt, because an episode without success is a result, too."""


def number_tasks(campaign: Campaign) -> Mapping[int, EvalTask]:
    """Returns the tasks of all policies by number; the same campaign gives the same numbers."""
    places = LoadedScenes(campaign.root)
    tasks: list[EvalTask] = []
    for policy in campaign.policies:
        tasks += tasks_for(campaign, policy, places, len(tasks) + 1)
    return {task.number: task for task in tasks}


def catalog_of(campaign: Campaign) -> Catalog:
    """Returns the scenes of a campaign.

    Raises:
        UsageError: The specs do not match the scenes.
    """
    places = LoadedScenes(campaign.root)
    entries: dict[str, SceneEntry] = {}
    for spec in campaign.specs.specs:
        entry = entries.get(spec.scene)
        if entry is None:
            entry = entries[spec.scene] = read_entry(places.path(spec.scene, spec.scene_sha256))
        if entry.sha256 != spec.scene_sha256:
            raise UsageError(f"the specs refer to two different packages of scene {spec.scene}; create new specs")
        if all(target.target_id != spec.target_id for target in entry.info.targets):
            raise UsageError(f"{spec.spec_id}: scene {spec.scene} has no target {spec.target_id}; create new specs")
    return entries


def attachments_of(campaign: Campaign) -> Attached:
    """Returns the files of the policies as attachments.

    Raises:
        UsageError: A file is missing or too large.
    """
    attached: dict[str, tuple[Attachment, Path]] = {}
    for policy in campaign.policies:
        path = file_of(campaign.reference(policy))
        if path is not None:
            size = path.stat().st_size
            if not 0 < size <= MAX_ATTACHMENT_BYTES:
                raise UsageError(f"{path} has {size} bytes; workers accept 1 to {MAX_ATTACHMENT_BYTES} bytes")
            with path.open("rb") as file:
                sha256 = hashlib.file_digest(file, "sha256").hexdigest()
            attached[policy] = Attachment(sha256=sha256, size=size), path
    return attached


def plan_of(campaign: Campaign, plan: Plan, tasks: Mapping[int, EvalTask], attached: Attached) -> Plan:
    """Returns the plan of the run: scenes and settings of the specs, and a name with a digest of all tasks.

    Args:
        campaign: campaign to run.
        plan: plan of the dataset.
        tasks: tasks of the campaign.
        attached: files of the campaign's policies.

    Raises:
        UsageError: A scene of the specs is not in the dataset.
    """
    counts = Counter(task.request.spec.scene for task in tasks.values())
    scenes = tuple(
        (part.as_scene() if isinstance(part, LayoutPlan) else part).model_copy(update={"episodes": counts[part.name]})
        for part in plan.parts
        if part.name in counts
    )
    strange = counts.keys() - {scene.name for scene in scenes}
    if strange:
        raise UsageError(f"the dataset has no scene {', '.join(sorted(strange))}; create new specs from it")
    settings = campaign.specs.settings
    numbers = {name: getattr(settings, name) for name in type(settings).model_fields}
    name = f"{EVALUATION_PREFIX}{_digest(campaign, tasks, attached)}"
    return plan.model_copy(update={"name": name, "scenes": scenes, "budget": _BUDGET, "rig": None, **numbers})


def planned_of(task: EvalTask) -> PlannedJob:
    return PlannedJob(task.number, 0, EpisodeSpec.of(task.request.spec, instruction=task.request.instruction))


def _digest(campaign: Campaign, tasks: Mapping[int, EvalTask], attached: Attached) -> str:
    digest = hashlib.sha256(canonical_json(campaign.setup).encode())
    for task in tasks.values():
        digest.update(f"{task.policy}\n{task.reference}\n{canonical_json(task.request)}\n".encode())
    for policy, (attachment, _) in attached.items():
        digest.update(f"{policy}\n{attachment.sha256}\n".encode())
    return digest.hexdigest()[:16]
