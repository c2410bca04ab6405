"""An evaluation as a run of tasks: a unique run name, and tasks with all data that a worker needs."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import pytest

from factory.dataset.reader import Dataset
from factory.eval.models.messages import EvalSetup, EvalTask
from factory.eval.models.result import Variant
from factory.eval.remote.tasks import attachments_of, catalog_of, number_tasks, plan_of, planned_of
from factory.eval.specs.campaign import Campaign, with_actions
from factory.eval.specs.from_dataset import specs_of_dataset
from schemas.episode_spec import EpisodeSpec
from schemas.errors import UsageError
from schemas.plan import Plan
from schemas.terms import Split
from tests.builders.evaluation import archive_drives


@pytest.fixture(scope="module")
def drives(tmp_path_factory: pytest.TempPathFactory) -> Dataset:
    """One archived drive."""
    return Dataset(archive_drives(tmp_path_factory.mktemp("drives") / "dataset", episodes=1))


@pytest.fixture(scope="module")
def campaign(drives: Dataset) -> Campaign:
    """The same episode with two policies."""
    specs = specs_of_dataset(drives, [Split.TRAIN_ID])
    return Campaign(specs, drives.root, ("stop", "replay"), (Variant.ORIGINAL,), EvalSetup(settings=specs.settings))


def plan_for(campaign: Campaign, drives: Dataset) -> Plan:
    return plan_of(campaign, drives.meta.plan, number_tasks(campaign), attachments_of(campaign))


def test_the_numbers_of_the_tasks_of_all_policies_are_reproducible(campaign: Campaign) -> None:
    tasks = number_tasks(campaign)
    assert [(index, task.number, task.policy) for index, task in tasks.items()] == [(1, 1, "stop"), (2, 2, "replay")]
    assert tasks == number_tasks(campaign)


def test_the_plan_has_the_scenes_and_settings_of_the_specs(campaign: Campaign, drives: Dataset) -> None:
    plan = plan_for(campaign, drives)
    assert Plan.model_validate_json(plan.model_dump_json()) == plan
    assert [(scene.name, scene.episodes) for scene in plan.scenes] == [("office", 2)]
    assert plan.task == campaign.specs.settings.task
    assert plan.run.startswith("eval_")


def test_every_setting_that_affects_results_changes_the_run_name(
    campaign: Campaign, drives: Dataset, tmp_path: Path
) -> None:
    settings = campaign.specs.settings
    slower = settings.model_copy(update={"robot": settings.robot.model_copy(update={"max_speed_mps": 0.5})})
    specs = campaign.specs.model_copy(update={"settings": slower})
    others = [
        dataclasses.replace(campaign, policies=("stop",)),
        dataclasses.replace(campaign, with_pose=True),
        dataclasses.replace(campaign, specs=specs, setup=EvalSetup(settings=slower)),
        dataclasses.replace(campaign, setup=campaign.setup.model_copy(update={"act_timeout_s": 1.0})),
    ]
    learned = dataclasses.replace(campaign, policies=(f"bc:{tmp_path}",))
    runs = {plan_for(other, drives).run for other in (campaign, *others)}
    for weights in (b"one", b"other"):
        (tmp_path / "policy.pt").write_bytes(weights)
        runs.add(plan_for(learned, drives).run)
    assert len(runs) == 7


def test_a_worker_gets_the_task_of_the_campaign_with_the_recorded_actions(campaign: Campaign, drives: Dataset) -> None:
    tasks = number_tasks(campaign)
    texts = [with_actions(task, campaign.root).model_dump_json() for task in tasks.values()]
    stop, replay = map(EvalTask.model_validate_json, texts)
    assert stop == tasks[1]
    assert replay.actions == tuple((float(v), float(w)) for v, w in drives["ep_000001"].actions)
    assert replay.model_copy(update={"actions": None}) == tasks[2]
    assert str(drives.root) not in texts[1]  # the task contains no path of this machine
    planned = planned_of(tasks[2])
    assert (planned.index, planned.episode) == (2, EpisodeSpec.of(tasks[2].request.spec))


def test_specs_that_do_not_fit_their_scene_are_refused_before_tasks_are_created(campaign: Campaign) -> None:
    def campaign_with(**changes: object) -> Campaign:
        (spec,) = campaign.specs.specs
        specs = campaign.specs.model_copy(update={"specs": (spec.model_copy(update=changes),)})
        return dataclasses.replace(campaign, specs=specs, policies=("stop",))

    assert list(catalog_of(campaign)) == ["office"]
    with pytest.raises(UsageError, match="no target chair_404"):
        catalog_of(campaign_with(target_id="chair_404"))
