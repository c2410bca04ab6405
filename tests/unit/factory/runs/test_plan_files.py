"""The files of a plan are checked before building; all missing ones are listed."""

from __future__ import annotations

from pathlib import Path

import pytest

from coordinator.expansion.builtin import BUILTIN_PLANS
from factory.runs.catalog import collect_scenes, require_files
from schemas.errors import InvalidPlan
from schemas.plan import Plan, ScenePlan
from schemas.terms import Split


def plan_in(folder: Path) -> Plan:
    files = {key: str(folder / name) for key, name in (("usd", "w.usda"), ("rules", "r.yaml"), ("targets", "t.yaml"))}
    lab = ScenePlan.model_validate({"name": "lab", "seen": ["chair"], "episodes": 2, **files})
    return Plan(name="mine", scenes=(ScenePlan(name="office", episodes=2), lab), splits={Split.TRAIN_ID: 1.0})


def test_all_missing_files_are_named_with_their_keys_and_remedies(tmp_path: Path) -> None:
    with pytest.raises(InvalidPlan) as caught:
        require_files(plan_in(tmp_path))
    usd, rules, targets = caught.value.findings
    assert usd.startswith(f"scenes[1] lab: file: no scene file at {tmp_path}/w.usda")
    assert rules.startswith(f"scenes[1] lab: rules: cannot read category rules from {tmp_path}/r.yaml")
    assert f"`factory scene targets lab -o {tmp_path}/t.yaml`" in targets
    assert targets.endswith(f"before that `factory scene import {tmp_path}/w.usda --name lab`")


def test_an_invalid_target_list_is_named_without_the_command_for_a_new_one(tmp_path: Path) -> None:
    for name in ("w.usda", "r.yaml", "t.yaml"):
        (tmp_path / name).write_text("[]")
    with pytest.raises(InvalidPlan, match=r"scenes\[1\] lab: targets: .*is not a valid targets file") as caught:
        require_files(plan_in(tmp_path))
    assert len(caught.value.findings) == 1
    assert "before that" not in str(caught.value)


def test_a_scene_of_the_dataset_and_a_built_in_scene_need_no_files(tmp_path: Path) -> None:
    require_files(plan_in(tmp_path), kept=["lab"])
    require_files(BUILTIN_PLANS["paper"])


def test_no_scene_is_built_for_a_plan_with_a_missing_file(tmp_path: Path) -> None:
    with pytest.raises(InvalidPlan):
        collect_scenes(plan_in(tmp_path), tmp_path / "data", tmp_path / "cache")
    assert not (tmp_path / "cache").exists()
