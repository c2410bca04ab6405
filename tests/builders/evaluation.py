"""Builds a small real dataset for evaluation, simulated in a room of boxes, and an evaluation on it."""

from __future__ import annotations

import dataclasses
import functools
import hashlib
import io
from pathlib import Path

from coordinator.archive.opening import open_archive
from coordinator.tables.write import write_tables
from factory.dataset.reader import Dataset
from factory.eval.models.messages import EvalSetup
from factory.eval.results.store import EvalManifest, Store
from factory.eval.specs.campaign import Campaign
from factory.eval.specs.from_dataset import specs_of_dataset
from schemas.config import RobotConfig, TaskConfig
from schemas.dataset.rows import summary_of
from schemas.episode import EpisodeMeta
from schemas.instruction.templates import instruction
from schemas.job import Job
from schemas.plan import Plan, ScenePlan
from schemas.scene import encode_scene
from schemas.terms import ExpertName, Split, Tier
from tests.builders.bundle import job_for
from tests.builders.dataset import NOW
from tests.builders.scene import box_room
from workers.sim.attempt import Success, run_attempt
from workers.sim.context import SimulationContext

SPLITS = (Split.TRAIN_ID, Split.TEST_ID, Split.TEST_ID)
TASK, ROBOT = TaskConfig(control_hz=20), RobotConfig(physics_substeps=12, max_braking_mps2=4.0)
"""The control rate is a third of the default, and the physics step has the default length. The braking limit is half of
the default, because control periods are long."""


@functools.cache
def room_package() -> bytes:
    """Returns the package of the room of boxes; its scene has the name that the small plan uses."""
    scene = box_room()
    return encode_scene(dataclasses.replace(scene, info=scene.info.model_copy(update={"name": "office"})))


def room_job(index: int, **changes: object) -> Job:
    """Returns a job in the room; the target is the crate if `index` is odd, otherwise the barrel."""
    package = room_package()
    category = "crate" if index % 2 else "barrel"
    target = next(target for target in box_room().info.targets if target.category == category)
    values = {
        "scene_sha256": hashlib.sha256(package).hexdigest(),
        "scene_bytes": len(package),
        "category": category,
        "target_id": target.target_id,
        "colour": "unknown",
        "instruction": instruction("train_01", category, "unknown"),
        "split": SPLITS[(index - 1) % len(SPLITS)],
        "tier": Tier.NEAR,
        "expert": ExpertName.PROPORTIONAL,
        "task": TASK,
        "robot": ROBOT,
    }
    return job_for(index, **values | changes)


def archive_drives(root: Path, episodes: int = 3) -> Path:
    """Simulates episodes 1 to `episodes`, archives the first success of each, and returns the dataset."""
    plan = Plan(
        name="test",
        scenes=(ScenePlan(name="office", episodes=episodes, seen=("crate",), held_out=("barrel",)),),
        tiers={Tier.NEAR: 1.0},
        splits={Split.TRAIN_ID: 0.5, Split.TEST_ID: 0.5},
        task=TASK,
        robot=ROBOT,
    )
    source = root.with_name(f"{root.name}.scene")
    source.write_bytes(room_package())
    sha256 = hashlib.sha256(room_package()).hexdigest()
    with open_archive(root) as archive, SimulationContext("auto") as stage:
        archive.add_scene(source, "office", sha256)
        stage.load(source, sha256)
        rows = []
        for index in range(1, episodes + 1):
            data, meta = _first_success(index, stage, plan.run, plan.digest)
            with archive.stage(index) as staged:
                staged.write(data)
                archive.publish(staged, index)
            rows.append(summary_of(meta, hashlib.sha256(data).hexdigest(), len(data)))
        write_tables(archive, plan, {"office": sha256}, rows, [], NOW)
    return root


def standing_still(drives: Dataset) -> Campaign:
    """Returns an evaluation of the policy `stop`, which does not move, in the test episodes, limited to ten steps."""
    specs = specs_of_dataset(drives, [Split.TEST_ID])
    task = specs.settings.task.model_copy(update={"max_steps": 10})
    specs = specs.model_copy(update={"settings": specs.settings.model_copy(update={"task": task})})
    return Campaign(specs, drives.root, ("stop",), (), EvalSetup(settings=specs.settings))


def open_store(root: Path, campaign: Campaign) -> Store:
    """Opens the results of a campaign."""
    manifest = EvalManifest(
        run=campaign.specs.run, specs_digest=campaign.specs.digest, with_pose=False, act_timeout_s=10.0
    )
    return Store(root, campaign.specs, manifest)


def _first_success(index: int, stage: SimulationContext, run: str, plan_digest: str) -> tuple[bytes, EpisodeMeta]:
    for attempt in range(1, 20):
        out = io.BytesIO()
        job = room_job(index, attempt=attempt, run=run, plan_digest=plan_digest)
        outcome = run_attempt(job, stage, out, "host-1", lambda _step: None)
        if isinstance(outcome, Success):
            return out.getvalue(), outcome.meta
    raise AssertionError(f"no attempt at {index} succeeds")
