"""Builds a small complete dataset through the real archive and the real tables, without any simulation."""

from __future__ import annotations

import dataclasses
import functools
import hashlib
import io
from collections.abc import Callable, Sequence
from datetime import UTC, datetime
from pathlib import Path

import numpy as np

from coordinator.archive.contract import Archive
from coordinator.archive.opening import open_archive
from coordinator.tables.split_tables import write_split_tables
from coordinator.tables.write import write_tables
from schemas.dataset.rows import EpisodeSummary, FailedAttempt, summary_of
from schemas.plan import Plan
from schemas.scene import CompiledScene, Instance, Target, encode_scene
from schemas.scene.complete import split_package
from schemas.terms import Split, Tier
from tests.builders.bundle import GOAL_M, TARGET_ID, BundleParts, job_for, parts_for
from tests.builders.layout_package import MadeLayout, layout_scene
from tests.builders.plan import small_plan
from tests.builders.scene import box_room

NOW = datetime(2026, 1, 2, 3, 4, 5, tzinfo=UTC)


def chair() -> Target:
    """Returns the target of the smallest bundle, as the scene describes it."""
    return Target(
        target_id="chair_001",
        category="chair",
        instance_id=TARGET_ID,
        prim_path="/World/chair_1",
        centroid_m=GOAL_M,
        size_m=(0.5, 0.5, 1.0),
        colour="red",
    )


@functools.cache
def office_package() -> bytes:
    """Returns a compiled scene named office that contains the chair."""
    return encode_scene(_with_chair(box_room()))


def office_scene() -> CompiledScene:
    """Returns a scene with two textures, named office, that contains the chair."""
    return _with_chair(layout_scene("office"))


def _with_chair(scene: CompiledScene) -> CompiledScene:
    instances = (Instance(id=TARGET_ID, prim_path="/World/chair_1", category="chair"),)
    info = scene.info.model_copy(update={"name": "office", "targets": (chair(),), "instances": instances})
    sees = np.ones((len(scene.spawns), 1), np.uint8)
    return dataclasses.replace(scene, info=info, spawn_sees=sees)


def make_dataset(
    root: Path,
    episodes: int = 3,
    planned: int | None = None,
    splits: Sequence[Split] = (Split.TRAIN_ID,),
    failures: Sequence[FailedAttempt] | None = None,
    with_split_tables: bool = True,
    package: bytes | None = None,
    change: Callable[[BundleParts], BundleParts] = lambda parts: parts,
    plan: Plan | None = None,
) -> Plan:
    """Writes a dataset of minimal episodes; returns its plan.

    Args:
        root: directory of the dataset.
        episodes: number of episodes to write.
        planned: number of episodes in the plan; the dataset is incomplete if it is larger than `episodes`.
        splits: splits that the episodes get in turn.
        failures: rows of failed attempts; `None` for one failure.
        with_split_tables: whether to write the tables of the splits.
        package: complete package of the scene; `None` for `office_package`.
        change: changes the parts of each episode.
        plan: plan to use instead of the small plan.
    """
    plan = plan or small_plan(planned or episodes)
    package, textures = split_package(io.BytesIO(package or office_package()))
    sha256 = hashlib.sha256(package).hexdigest()
    layout = MadeLayout(package, textures)
    source = layout.write(root.with_name(f"{root.name}.scene"))
    with open_archive(root) as archive:
        archive.add_scene(source, "office", sha256, layout.names)
        rows = [
            archive_episode(
                archive, change(episode_of(plan, index, sha256, len(package), splits[(index - 1) % len(splits)]))
            )
            for index in range(1, episodes + 1)
        ]
        lost = [failure(1)] if failures is None else failures
        write_tables(archive, plan, {"office": sha256}, rows, lost, NOW)
        if with_split_tables:
            write_split_tables(archive)
    return plan


def episode_of(
    plan: Plan, index: int, scene_sha256: str, scene_bytes: int, split: Split = Split.TRAIN_ID
) -> BundleParts:
    """Returns the parts of an episode of the plan."""
    made_with = {"plan_digest": plan.digest, "scene_sha256": scene_sha256, "scene_bytes": scene_bytes}
    job = job_for(index, run=plan.run, split=split, **made_with)
    return parts_for(job)


def archive_episode(archive: Archive, parts: BundleParts) -> EpisodeSummary:
    """Publishes an episode without validating it and returns its row."""
    (data, sealed), index = parts.write_sealed(), parts.meta.job.index
    with archive.stage(index) as staged:
        staged.write(data)
        archive.publish(staged, index)
    return summary_of(sealed, hashlib.sha256(data).hexdigest(), len(data))


def failure(index: int, attempt: int = 1) -> FailedAttempt:
    """Returns the row of an attempt that timed out."""
    return FailedAttempt(
        episode_id=f"ep_{index:06d}",
        draw=0,
        attempt=attempt,
        scene="office",
        spawn_tier=Tier.NEAR,
        split=Split.TRAIN_ID,
        target_category="chair",
        target_id="chair_001",
        reason="timeout",
        detail="timeout after 1000 steps, 2.10 m from chair_001",
        steps=1000,
        seconds=16.5,
        worker="host-1",
        at=NOW,
    )
