"""Rigs of plans: names, files and tables, the rig of the recorded camera, and rigs that do not fit."""

from __future__ import annotations

from pathlib import Path

import pytest

from coordinator.expansion.draw import expand, to_job
from coordinator.expansion.plan_file import load_plan, plan_to_toml, shrink, with_rig
from schemas.errors import InvalidPlan, InvalidRig, UsageError
from schemas.plan import Plan, ScenePlan
from schemas.rig.rig_file import load_rig, paper_rig
from schemas.terms import Recording
from schemas.view import ViewSettings
from tests.builders.catalog import make_catalog
from tests.builders.rigs import small_rig, write_rig

SCENE = '[[scenes]]\nname = "office"\nepisodes = 20\n'
PLAIN = Plan(name="mine", scenes=(ScenePlan(name="office", episodes=20),))


def written(folder: Path, text: str) -> Plan:
    path = folder / "mine.toml"
    path.write_text(text + SCENE)
    return load_plan(str(path))


def test_a_plan_names_a_built_in_rig_or_a_file_beside_it(tmp_path: Path) -> None:
    write_rig(tmp_path)
    assert written(tmp_path, 'rig = "turtlebot4"\n').rig == load_rig("turtlebot4")
    plan = written(tmp_path, 'rig = "small.toml"\n')
    assert plan.rig is not None
    assert plan.rig.name == "small"
    path = tmp_path / "again.toml"
    path.write_text(plan_to_toml(plan))
    assert load_plan(str(path)).digest == plan.digest


def test_a_plan_without_a_rig_and_one_with_the_rig_paper_are_equal(tmp_path: Path) -> None:
    assert written(tmp_path, 'rig = "paper"\n').digest == written(tmp_path, "").digest
    assert "rig" not in PLAIN.model_dump()
    assert shrink(with_rig(PLAIN, small_rig()), rig=paper_rig()).digest == PLAIN.digest
    narrow = PLAIN.model_copy(update={"camera": PLAIN.camera.model_copy(update={"fov_deg": 60.0})})
    assert with_rig(narrow, paper_rig()).rig == paper_rig()


def test_rigs_give_plans_different_digests() -> None:
    rigs = (None, small_rig(), small_rig(has_noise=False), load_rig("panorama"))
    assert len({with_rig(PLAIN, rig).digest for rig in rigs}) == 4


@pytest.mark.parametrize(
    ("text", "error", "expected"),
    [
        ('rig = "turtlebot5"\n', UsageError, "no rig '.*turtlebot5': no such file.*did you mean 'turtlebot4'"),
        ('rig = "turtlebot4"\ntask = { control_hz = 50 }\n', InvalidRig, "rate_hz 30 does not divide the control rate"),
        ("rig = { name = 'mine', sensors = [] }\n", InvalidPlan, "rig.sensors"),
    ],
)
def test_a_rig_that_does_not_exist_or_fit_is_refused(
    tmp_path: Path, text: str, error: type[Exception], expected: str
) -> None:
    with pytest.raises(error, match=expected):
        written(tmp_path, text)


def test_a_job_is_rendered_with_the_rig_if_it_records_frames() -> None:
    plan = with_rig(PLAIN, small_rig())
    catalog = make_catalog(plan)
    planned = next(iter(expand(plan, catalog)))
    assert to_job(plan, catalog, planned, 1).view == ViewSettings(rig=small_rig())
    states = shrink(plan, record=Recording.STATES)
    assert to_job(states, catalog, planned, 1).view == ViewSettings()
