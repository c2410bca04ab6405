"""Unfiltered starts of an evaluation: what the instruction requires of the start view is true at each start."""

from __future__ import annotations

import hashlib
import math
from collections.abc import Iterator
from pathlib import Path
from typing import Literal

import pytest

from coordinator.archive.opening import open_archive
from coordinator.tables.write import write_tables
from factory.dataset.reader import Dataset
from factory.eval.driving.simulator import Simulator
from factory.eval.models.spec import SpecSet
from factory.eval.specs.unfiltered import unfiltered_specs
from schemas.config import InstructionConfig
from schemas.instruction.referents import ids_in_view
from schemas.instruction.start_view import IN_FRONT_RAD
from schemas.instruction.templates import says_in_front
from schemas.plan import Plan, ScenePlan
from schemas.scene import encode_scene
from schemas.terms import Split, Tier
from tests.builders.dataset import NOW
from tests.builders.scene import Box, build_scene, room_walls
from workers.sim.context import SimulationContext, prepare_scene

LEFT = Box((1.2, 0.9, 0.0), (1.8, 1.5, 0.6), (200, 30, 30), category="crate")
RIGHT = Box((1.2, -1.5, 0.0), (1.8, -0.9, 0.6), (30, 30, 200), category="crate")
SCENE = build_scene((*room_walls((-6.0, -4.0), (4.0, 4.0)), LEFT, RIGHT))
Unique = Literal["view", "off"]
EPISODES = 28  # two for each template that names no colour


def make_dataset(root: Path, unique: Unique) -> Dataset:
    """Returns a dataset without episodes whose scene is a room with two crates."""
    plan = Plan(
        name="two_crates",
        scenes=(ScenePlan(name="boxes", usd="boxes.usda", episodes=EPISODES, seen=("crate",)),),
        tiers={Tier.NEAR: 0.5, Tier.FAR: 0.5},
        splits={Split.TRAIN_ID: 1.0},
        instructions=InstructionConfig(unique=unique),
    )
    package = encode_scene(SCENE, level=1)
    source, sha256 = root.with_name(f"{root.name}.scene"), hashlib.sha256(package).hexdigest()
    source.write_bytes(package)
    with open_archive(root) as archive:
        archive.add_scene(source, "boxes", sha256)
        write_tables(archive, plan, {"boxes": sha256}, [], [], NOW)
    return Dataset(root)


def views(specs: SpecSet, stage: SimulationContext) -> list[tuple[bool, bool, bool, float]]:
    """Returns four values for each spec: whether its instruction says "in front", whether the target and whether the
    other crate are in view, and the angle between the heading and the direction to the target, radians."""
    found = []
    crates = {target.instance_id for target in SCENE.info.targets}
    place = prepare_scene(SCENE)
    with Simulator(stage, specs.settings) as simulator:
        for spec in specs.specs:
            view = simulator.reset(spec, place)
            target = SCENE.info.target(spec.target_id)
            shown = ids_in_view(view.frame.ids, specs.settings.gains.min_mask_px)
            bearing = math.atan2(target.centroid_m[1] - view.pose.y, target.centroid_m[0] - view.pose.x)
            others = crates - {target.instance_id}
            off_rad = abs(math.remainder(bearing - view.pose.yaw, 2 * math.pi))
            words = says_in_front(spec.template_id)
            found.append((words, target.instance_id in shown, bool(shown & others), off_rad))
    return found


@pytest.fixture(scope="module")
def stage() -> Iterator[SimulationContext]:
    with SimulationContext("auto") as opened:
        yield opened


@pytest.mark.parametrize("unique", ["view", "off"])
def test_unfiltered_starts_meet_the_conditions_on_the_start_view(
    tmp_path: Path, stage: SimulationContext, unique: Unique
) -> None:
    specs = unfiltered_specs(make_dataset(tmp_path / "data", unique), [Split.TRAIN_ID], EPISODES, 7, stage)
    found = views(specs, stage)
    in_front = [row for row in found if row[0]]
    assert len(in_front) == 2
    assert all(shows and off_rad <= IN_FRONT_RAD for _, shows, _, off_rad in in_front)
    clear = [shows and not other for _, shows, other, _ in found]
    assert all(clear) if unique == "view" else not all(clear)
    assert [spec.is_target_in_view for spec in specs.specs] == [shows for _, shows, _, _ in found]
