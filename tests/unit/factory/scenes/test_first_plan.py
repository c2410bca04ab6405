"""The plan that is proposed for an imported scene is feasible in this scene and can be read back."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import pytest

from coordinator.expansion.plan_file import load_plan, plan_to_toml
from coordinator.expansion.possible import find_impossible
from factory.scenes.inspection import draft_plan
from schemas.terms import Split, Tier
from tests.builders.catalog import make_entry, make_target

ALL = tuple(Tier)


@pytest.mark.parametrize(
    ("kinds", "tiers", "seen", "held_out"),
    [
        (["shelf", "shelf", "bin"], ALL, ("shelf",), ("bin",)),
        (["shelf", "shelf"], ALL, ("shelf",), ()),
        (["shelf", "bin"], (Tier.NEAR,), ("bin",), ("shelf",)),
    ],
)
def test_the_proposed_plan_is_feasible(
    tmp_path: Path, kinds: list[str], tiers: Sequence[Tier], seen: tuple[str, ...], held_out: tuple[str, ...]
) -> None:
    entry = make_entry("lab", [make_target(kind, n, n, tiers=tiers) for n, kind in enumerate(kinds, 1)])
    plan = draft_plan(entry, "/data/lab.usda", targets="/data/targets_lab.yaml")
    assert plan is not None
    file = tmp_path / "lab.toml"
    file.write_text(plan_to_toml(plan))
    assert load_plan(str(file)) == plan
    assert find_impossible(plan, {"lab": entry}) == []
    (scene,) = plan.scenes
    assert (scene.categories, scene.targets) == ((seen, held_out), "/data/targets_lab.yaml")
    assert (plan.splits_of(scene).get(Split.TEST_OOD_OBJ, 0) > 0) == bool(held_out)


def test_a_scene_without_a_start_has_no_proposed_plan() -> None:
    assert draft_plan(make_entry("lab", [make_target("shelf", 1, 1, tiers=())]), "/data/lab.usda") is None
