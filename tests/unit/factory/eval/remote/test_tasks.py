"""An evaluation as a run of tasks: a unique run name, and tasks with all data that a worker needs."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import pytest

from factory.dataset.reader import Dataset
from factory.eval.models.messages import EvalTask, Setup
from factory.eval.models.result import Variant
from factory.eval.remote.tasks import attachments_of, catalog_of, number_orders, plan_of, planned_of, text_of
from factory.eval.specs.campaign import Campaign
from factory.eval.specs.from_dataset import specs_of_dataset
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
    return Campaign(specs, drives.root, ("stop", "replay"), (Variant.ORIGINAL,), Setup(settings=specs.settings))


def plan_for(campaign: Campaign, drives: Dataset) -> Plan:
    return plan_of(campaign, drives.meta.plan, number_orders(campaign), attachments_of(campaign))


def test_task_numbers_of_all_policies_are_deterministic(campaign: Campaign) -> None:
    orders = number_orders(campaign)
    assert [(index, order.policy) for index, order in orders.items()] == [(1, "stop"), (2, "replay")]
    assert orders == number_orders(campaign)


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
        dataclasses.replace(campaign, specs=specs, setup=Setup(settings=slower)),
        dataclasses.replace(campaign, setup=campaign.setup.model_copy(update={"act_timeout_s": 1.0})),
    ]
    learned = dataclasses.replace(campaign, policies=(f"bc:{tmp_path}",))
    runs = {plan_for(other, drives).run for other in (campaign, *others)}
    for weights in (b"one", b"other"):
        (tmp_path / "policy.pt").write_bytes(weights)
        runs.add(plan_for(learned, drives).run)
    assert len(runs) == 7


def test_a_task_contains_the_spec_and_the_recorded_actions(campaign: Campaign, drives: Dataset) -> None:
    orders = number_orders(campaign)
    stop, replay = (EvalTask.model_validate_json(text_of(campaign, order)) for order in orders.values())
    assert stop.actions is None
    assert replay.actions == tuple((float(v), float(w)) for v, w in drives["ep_000001"].actions)
    assert replay.question == orders[2].question
    assert str(drives.root) not in text_of(campaign, orders[2])  # no path of this machine
    planned = planned_of(orders[2], 2)
    spec = orders[2].question.spec
    assert (planned.index, planned.target_id, planned.instruction) == (2, spec.target_id, spec.instruction)


def test_specs_that_do_not_fit_their_scene_are_refused_before_tasks_are_created(campaign: Campaign) -> None:
    def orders_with(**changes: object) -> Campaign:
        (spec,) = campaign.specs.specs
        specs = campaign.specs.model_copy(update={"specs": (spec.model_copy(update=changes),)})
        return dataclasses.replace(campaign, specs=specs, policies=("stop",))

    assert list(catalog_of(number_orders(campaign))) == ["office"]
    with pytest.raises(UsageError, match="no target chair_404"):
        catalog_of(number_orders(orders_with(target_id="chair_404")))
