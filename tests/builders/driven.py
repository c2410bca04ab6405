"""Builds a dataset of real drives in a small room, recorded as frames or as states, without a coordinator."""

from __future__ import annotations

import functools
import hashlib
import io
from itertools import count
from pathlib import Path

from coordinator.archive.contract import Archive
from coordinator.archive.opening import open_archive
from coordinator.expansion.catalog import Catalog, read_entry
from coordinator.expansion.draw import PlannedJob, expand, to_job
from coordinator.tables.split_tables import write_split_tables
from coordinator.tables.write import write_tables
from schemas.appearance import Appearance
from schemas.config import RobotConfig, TaskConfig
from schemas.dataset.rows import EpisodeSummary, summary_of
from schemas.plan import Plan, ScenePlan
from schemas.scene import encode_scene
from schemas.terms import ExpertName, Recording, Split, Tier
from tests.builders.dataset import NOW
from tests.builders.scene import box_room
from tests.builders.shared import build_once
from workers.sim.attempt import Success, run_attempt
from workers.sim.context import SimulationContext

SCENE = "box_room"
CONTROL_HZ = 30
"""Frames per second of the drives: half the usual rate, so fewer frames are rendered."""


def driven_plan(
    record: Recording,
    episodes: int = 2,
    expert: ExpertName = ExpertName.PROPORTIONAL,
    seed: int = 42,
    appearance: Appearance | None = None,
) -> Plan:
    """Returns a plan of near episodes with short drives; the physics step has its usual length."""
    return Plan(
        name="driven",
        seed=seed,
        scenes=(ScenePlan(name=SCENE, episodes=episodes, usd="room.usda", seen=("crate", "barrel")),),
        tiers={Tier.NEAR: 1.0},
        splits={Split.TRAIN_ID: 1.0},
        task=TaskConfig(control_hz=CONTROL_HZ, success_radius_m=1.4),
        robot=RobotConfig(physics_substeps=8),
        expert=expert,
        record=record,
        appearance=appearance,
    )


def make_driven(
    root: Path,
    record: Recording,
    episodes: int = 2,
    expert: ExpertName = ExpertName.PROPORTIONAL,
    seed: int = 42,
    appearance: Appearance | None = None,
) -> Plan:
    """Drives and archives all episodes of `driven_plan`; returns the plan. Needs an EGL driver."""
    plan = driven_plan(record, episodes, expert, seed, appearance)
    source = root.with_name(f"{root.name}.scene")
    source.write_bytes(encode_scene(box_room()))
    catalog = {SCENE: read_entry(source)}
    with open_archive(root) as archive, SimulationContext("gl", apart=True) as stage:
        stage.load(source, catalog[SCENE].sha256)
        archive.add_scene(source, SCENE, catalog[SCENE].sha256)
        rows = [_archive(archive, stage, plan, catalog, planned) for planned in expand(plan, catalog)]
        write_tables(archive, plan, {SCENE: catalog[SCENE].sha256}, rows, [], NOW)
        write_split_tables(archive)
    return plan


def driven_recordings(shared: Path) -> dict[Recording, Path]:
    """Returns the same two drives recorded as frames and as states; tests only read them. Needs an EGL driver."""
    return {
        record: build_once(shared / f"driven-{record}", functools.partial(make_driven, record=record))
        for record in Recording
    }


def _archive(
    archive: Archive, stage: SimulationContext, plan: Plan, catalog: Catalog, planned: PlannedJob
) -> EpisodeSummary:
    for attempt in count(1):
        job = to_job(plan, catalog, planned, attempt)
        file = io.BytesIO()
        outcome = run_attempt(job, stage, file, "host-1", lambda _step: None)
        if isinstance(outcome, Success):
            data = file.getvalue()
            with archive.stage(job.index) as staged:
                staged.write(data)
                archive.publish(staged, job.index)
            return summary_of(outcome.meta, hashlib.sha256(data).hexdigest(), len(data))
    raise AssertionError("unreachable")
