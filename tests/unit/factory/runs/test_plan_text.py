"""Expected share of far starts behind a corner: the same share as among the surveyed points in the plan's range."""

from __future__ import annotations

import numpy as np
import pytest

from coordinator.expansion.catalog import SceneEntry, read_entry
from factory.runs.plan_text import corner_shares
from schemas.config import SpawnConfig, TaskConfig
from schemas.plan import Plan, ScenePlan
from schemas.scene import encode_scene
from schemas.terms import ExpertName, Screening, Split, Tier
from tests.builders.scene import Box, build_scene, room_walls
from workers.planning import geodesic_m
from workers.sim.context import prepare_scene

CRATE = Box((-0.3, -0.3, 0.0), (0.3, 0.3, 0.6), category="crate")
WALL = (Box((-7.0, 1.2, 0.0), (4.0, 1.4, 2.5)), Box((5.2, 1.2, 0.0), (7.0, 1.4, 2.5)))
SCENE = build_scene((*room_walls((-7.0, -7.0), (7.0, 7.0)), CRATE, *WALL))


@pytest.fixture(scope="module")
def entry(tmp_path_factory: pytest.TempPathFactory) -> SceneEntry:
    path = tmp_path_factory.mktemp("scene") / "room.scene.zip"
    path.write_bytes(encode_scene(SCENE, level=1))
    return read_entry(path)


def far_plan(screening: Screening = Screening.NONE, tier: Tier = Tier.FAR, **changes: object) -> Plan:
    plan = Plan(
        name="x",
        scenes=(ScenePlan(name="room", usd="room.usda", seen=("crate",), episodes=3),),
        tiers={tier: 1.0},
        splits={Split.TRAIN_ID: 1.0},
        spawn=SpawnConfig(screening=screening, far_floor_m=(5.0, 8.0)),
    )
    return plan.model_copy(update=changes)


def test_the_share_is_that_of_points_whose_path_is_longer_than_the_straight_line(entry: SceneEntry) -> None:
    place, target = prepare_scene(SCENE), SCENE.info.targets[0]
    ways = [(geodesic_m(place.grid, point, target, TaskConfig()), np.linalg.norm(point)) for point in SCENE.spawns]
    far = [(way, straight - 1.0) for way, straight in ways if way is not None and 4.0 <= way <= 7.0]
    bent = np.mean([way > straight + 1e-6 for way, straight in far])
    assert 0.1 < bent < 0.9
    assert corner_shares(far_plan(), {"room": entry}) == {"room": pytest.approx(bent, abs=0.03)}
    planner = far_plan(expert=ExpertName.PLANNER)
    assert corner_shares(planner, {"room": entry}) == {"room": pytest.approx(bent, abs=0.03)}


def test_the_share_of_corners_is_zero_for_screened_starts_and_missing_without_far_starts(entry: SceneEntry) -> None:
    assert corner_shares(far_plan(Screening.FORESEEN), {"room": entry}) == {"room": 0.0}
    assert corner_shares(far_plan(tier=Tier.NEAR), {"room": entry}) == {}
