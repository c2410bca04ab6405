"""Describes the source of an export by its content; describes a states dataset like a frames dataset of the same plan.

Times and workers are excluded, so datasets with equal content give equal exports. Reads tables and metadata only.

Design: docs/design/data.md#exports-describe-the-frames-dataset.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Sequence
from typing import Any

import pyarrow as pa

from factory.dataset.episode import Episode
from factory.dataset.reader import Dataset
from schemas.dataset.meta import DatasetMeta, described_as_frames, read_dataset_meta
from schemas.episode import EpisodeMeta
from schemas.rig import Rig
from schemas.scene import Instance
from schemas.storage.place import Place
from schemas.terms import Recording

TIMES_AND_WORKERS = frozenset({"created_at", "updated_at", "worker"})
"""Fields of `meta.json`, `dataset_meta.json` and the tables that differ between runs with equal content."""
_OF_RECORDING = frozenset({"frame_digests", "content_digest"})
_IDENTITY = (
    *("episode_id", "split", "instruction", "target_id", "scene_sha256", "draw", "attempt", "renderer"),
    *("num_steps", "spawn_x_m", "spawn_y_m", "spawn_yaw_rad", "trajectory_length_m", "final_ne_3d_m", "min_ne_m"),
)
"""Columns that identify an episode. Their values are equal in a frames and in a states recording."""


def open_source(root: Place, rig: str | Rig | None = None) -> Dataset:
    """Opens a dataset and describes it like a frames recording; raises the errors of `Dataset`.

    Without `rig`, the recorded camera is exported, even if the plan of the dataset has a rig. The name of the plan's
    rig selects it, even if it was a file.
    """
    own = read_dataset_meta(root).plan.rig
    if own is not None and rig == own.name:
        rig = own
    dataset = Dataset(root, rig)
    if rig is None:
        dataset.rig = None
    dataset.meta = described_as_frames(dataset.meta)
    return dataset


def recorded_run(root: Place) -> tuple[str, Recording]:
    """Returns the name of the run of a dataset, and its kind of recording, as the dataset itself states them."""
    meta = read_dataset_meta(root)
    return meta.run, meta.plan.record


def rows_digest(rows: pa.Table) -> str:
    """Returns the SHA-256 over the identifying columns of `metadata.parquet`; it depends on the order of the rows."""
    digest = hashlib.sha256()
    for name in _IDENTITY:
        digest.update(json.dumps([name, rows[name].to_pylist()]).encode())
    return digest.hexdigest()


def as_frames(episode: Episode, steps_visible: int) -> EpisodeMeta:
    """Returns the metadata that an episode has in a frames recording, but with the digests of its states recording.

    Args:
        episode: episode of a states recording.
        steps_visible: number of frames in which the target is visible.
    """
    described = read_dataset_meta(episode.path.parents[1])
    source = described.source_of(episode.summary.index)
    framed = (described.plan if source is None else source.plan).model_copy(update={"record": Recording.FRAMES})
    plan = {"record": Recording.FRAMES, "run": framed.run, "plan_digest": framed.digest}
    meta = episode.meta
    return meta.with_frames(meta.job.model_copy(update=plan), steps_visible, episode.instances)


def describe_episode(episode: Episode) -> dict[str, Any]:
    """Returns the metadata of an episode without values that need all frames: digests and `steps_visible`."""
    is_stored = episode.meta.job.record is Recording.FRAMES
    values = plain_meta(episode.meta if is_stored else as_frames(episode, 0))
    del values["rollout"]["steps_visible"]
    return {name: value for name, value in values.items() if name not in _OF_RECORDING}


def instances_json(instances: Sequence[Instance]) -> str:
    """Returns the names of the instance ids as JSON: a list of `id`, `prim_path`, `category`, `materials`."""
    return json.dumps([each.model_dump(mode="json") for each in instances], ensure_ascii=False)


def plain_meta(meta: EpisodeMeta) -> dict[str, Any]:
    """Returns the metadata of an episode as JSON values, without time and worker."""
    return meta.model_dump(mode="json", exclude={"provenance": set(TIMES_AND_WORKERS)})


def plain_dataset_meta(meta: DatasetMeta) -> dict[str, Any]:
    """Returns the description of a dataset as JSON values, without times."""
    return meta.model_dump(mode="json", exclude=set(TIMES_AND_WORKERS))


def to_json(values: dict[str, Any]) -> str:
    """Returns JSON values as text with one value per line."""
    return json.dumps(values, indent=1, ensure_ascii=False)
