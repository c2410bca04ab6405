"""Checks of the output directory of a run before building."""

from __future__ import annotations

from pathlib import Path

import pytest

from coordinator.expansion.plan_file import load_plan
from factory.dataset.site import site_of
from factory.runs.plan_changes import PlanChanges
from factory.runs.start import begin
from schemas.errors import UsageError, WorldError
from schemas.terms import SuccessMeasure
from tests.builders.dataset import make_dataset


def test_a_directory_that_cannot_be_read_is_an_error_with_a_remedy(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def denied(_: Path) -> None:
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr(Path, "iterdir", denied)  # root reads everything
    with pytest.raises(WorldError, match=f"cannot look into {tmp_path}: Permission denied"):
        begin("demo", site_of(str(tmp_path)), PlanChanges())


def test_a_run_in_a_new_directory_is_new_and_a_directory_within_a_dataset_is_refused(tmp_path: Path) -> None:
    assert begin("demo", site_of(str(tmp_path / "new")), PlanChanges()).is_new
    (tmp_path / "dataset_meta.json").write_text("{}")
    with pytest.raises(UsageError, match=f"is inside the dataset {tmp_path}"):
        begin("demo", site_of(str(tmp_path / "new")), PlanChanges())


FILE = """
[splits]
train_id = 1.0
[[scenes]]
name = "office"
seen = ["chair"]
episodes = 3
"""


@pytest.mark.parametrize("success", SuccessMeasure)
def test_a_plan_file_without_success_measure_continues_a_dataset_with_the_measure_of_its_plan(
    tmp_path: Path, success: SuccessMeasure
) -> None:
    plan_file, root = tmp_path / "mine.toml", tmp_path / "data"
    plan_file.write_text(FILE)
    recorded = load_plan(str(plan_file), success)
    make_dataset(root, 3, plan=recorded)
    found = begin(str(plan_file), site_of(str(root)), PlanChanges())
    assert (found.plan.digest, found.plan.task.success, found.is_new) == (recorded.digest, success, False)
    plan_file.write_text(
        FILE + f'[task]\nsuccess = "{next(other for other in SuccessMeasure if other is not success)}"\n'
    )
    with pytest.raises(UsageError, match="mine"):
        begin(str(plan_file), site_of(str(root)), PlanChanges())
