"""Far starts of a target depend on the plan's minimum far distance; packages list far tiers for the default only."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from coordinator.expansion.catalog import SceneEntry, read_entry
from coordinator.expansion.draw import expand
from coordinator.expansion.possible import find_impossible
from schemas.config import SpawnConfig, TaskConfig
from schemas.plan import Plan, ScenePlan
from schemas.scene import Target, encode_scene
from schemas.terms import ExpertName, Screening, Split, SuccessMeasure, Tier
from tests.builders.scene import Box, build_scene, room_walls


@pytest.fixture(scope="module")
def entry(tmp_path_factory: pytest.TempPathFactory) -> SceneEntry:
    """A room of 4.6 x 3 m with a crate near one end. Its package has no far tier: no floor is 5 m from the crate."""
    crate = Box((-2.0, -0.2, 0.0), (-1.6, 0.2, 0.6), category="crate")
    scene = build_scene((*room_walls((-2.3, -1.5), (2.3, 1.5)), crate))
    names = [name for name in Target.model_fields if name.endswith("_tiers")]
    near = [target.model_copy(update=dict.fromkeys(names, (Tier.NEAR,))) for target in scene.info.targets]
    scene = replace(scene, info=scene.info.model_copy(update={"targets": tuple(near)}))
    path = tmp_path_factory.mktemp("scene") / "room.scene.zip"
    path.write_bytes(encode_scene(scene, level=1))
    return read_entry(path)


def far_plan(least_m: float, screening: Screening, expert: ExpertName, success: SuccessMeasure) -> Plan:
    return Plan(
        name="x",
        scenes=(ScenePlan(name="room", usd="room.usda", seen=("crate",), episodes=2),),
        tiers={Tier.FAR: 1.0},
        splits={Split.TRAIN_ID: 1.0},
        expert=expert,
        task=TaskConfig(success=success),
        spawn=SpawnConfig(screening=screening, far_floor_m=(least_m, 11.0)),
    )


@pytest.mark.parametrize("success", SuccessMeasure)
@pytest.mark.parametrize(
    ("screening", "expert"),
    [
        (Screening.NONE, ExpertName.PROPORTIONAL),
        (Screening.FORESEEN, ExpertName.PROPORTIONAL),
        (Screening.FORESEEN, ExpertName.PLANNER),
    ],
)
def test_a_small_room_has_far_starts_at_the_distance_that_the_plan_permits(
    entry: SceneEntry, screening: Screening, expert: ExpertName, success: SuccessMeasure
) -> None:
    catalog = {"room": entry}
    short = far_plan(2.5, screening, expert, success)
    assert find_impossible(short, catalog) == []
    assert [planned.episode.tier for planned in expand(short, catalog)] == [Tier.FAR] * 2
    for least_m in (4.5, 5.0, 6.0):
        (line,) = find_impossible(far_plan(least_m, screening, expert, success), catalog)
        assert "cell train_id / far (2 episodes) has no target" in line


def test_a_plan_with_the_default_distance_reads_no_package() -> None:
    """A plan with many scenes would otherwise read the package of every scene."""
    absent = far_plan(5.0, Screening.NONE, ExpertName.PROPORTIONAL, SuccessMeasure.CENTROID)
    crate = Box((-0.3, -0.3, 0.0), (0.3, 0.3, 0.6), category="crate")
    info = build_scene((*room_walls((-9.0, -9.0), (9.0, 9.0)), crate)).info
    assert find_impossible(absent, {"room": SceneEntry(info, "0" * 64, 1, Path("absent.zip"))}) == []
