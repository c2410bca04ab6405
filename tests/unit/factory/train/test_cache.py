"""The cache of downscaled frames: content, reuse, and rebuilding after damage."""

from __future__ import annotations

import threading
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import pytest

from factory.dataset.reader import Dataset
from factory.train.frames import CacheKey, TrainingFrames, chosen_frames, goal_labels, label_episode, stop_frame
from factory.train.pictures import open_cache
from factory.train.preprocess import shrink_depth, shrink_mask, shrink_rgb
from schemas.errors import ArchiveCorrupt, UsageError, WorldError
from tests.builders.dataset import make_dataset

SIZE, HOLD = 64, 3


@pytest.fixture(scope="module")
def data(tmp_path_factory: pytest.TempPathFactory) -> Dataset:
    root = tmp_path_factory.mktemp("cached") / "data"
    make_dataset(root, 2)
    return Dataset(root)


def opened(data: Dataset, root: Path) -> tuple[TrainingFrames, list[tuple[int, int]]]:
    told: list[tuple[int, int]] = []
    return open_cache(data, SIZE, HOLD, "braking", root, lambda done, of: told.append((done, of))), told


def test_the_cache_has_the_content_of_the_episodes(data: Dataset, tmp_path: Path) -> None:
    cache, told = opened(data, tmp_path)
    episode = data[1]
    frames = chosen_frames(len(episode), HOLD)
    assert told == [(1, 2), (2, 2)]
    assert len(cache) == 2 * len(frames)
    assert [(entry.episode_id, entry.first, entry.frames) for entry in cache.index.episodes] == [
        ("ep_000001", 0, len(frames)),
        ("ep_000002", len(frames), len(frames)),
    ]
    row = len(frames) + 2
    frame = episode.frame(int(frames[2]))
    assert cache.episode[row] == 1
    assert np.array_equal(cache.pictures.rgb[row], shrink_rgb(frame.rgb, SIZE))
    assert np.array_equal(cache.pictures.depth[row], shrink_depth(frame.depth, SIZE))
    assert np.array_equal(cache.pictures.mask[row], shrink_mask(frame.ids, episode.meta.target_instance_id, SIZE // 8))
    job = episode.meta.job
    stop = stop_frame(episode.actions, job.robot.max_braking_mps2, job.task.control_hz)
    goal = goal_labels(episode.meta, episode.poses)
    labels = label_episode(episode.actions, frames, stop, HOLD, goal)
    assert np.array_equal(cache.labels.goal[len(frames) :], labels.goal)
    assert np.array_equal(cache.labels.actions[len(frames) :], labels.actions)
    assert np.array_equal(cache.labels.is_stop[len(frames) :], labels.is_stop)
    assert cache.index.control_hz == episode.meta.job.task.control_hz


def test_a_second_opening_decodes_no_frame(data: Dataset, tmp_path: Path) -> None:
    first, _ = opened(data, tmp_path)
    second, told = opened(data, tmp_path)
    assert told == []
    assert np.array_equal(first.pictures.rgb, second.pictures.rgb)
    assert isinstance(second.pictures.rgb, np.memmap)


def test_the_name_of_a_cache_depends_on_content_size_and_hold(data: Dataset) -> None:
    key = CacheKey(dataset=data.digest, size=SIZE, hold=HOLD, stops="braking")
    others = (
        CacheKey(dataset=data.filter(episode="ep_000001").digest, size=SIZE, hold=HOLD, stops="braking"),
        CacheKey(dataset=data.digest, size=128, hold=HOLD, stops="braking"),
        CacheKey(dataset=data.digest, size=SIZE, hold=6, stops="braking"),
        CacheKey(dataset=data.digest, size=SIZE, hold=HOLD, stops="success"),
    )
    assert len({key.name, *(other.name for other in others)}) == 5


def test_a_cache_without_a_readable_index_is_rebuilt(data: Dataset, tmp_path: Path) -> None:
    opened(data, tmp_path)
    (index,) = tmp_path.glob("*/index.json")
    index.write_text('{"key": 1}')
    cache, told = opened(data, tmp_path)
    assert told
    assert len(cache)


def test_damaged_cache_is_named_with_the_remedy(data: Dataset, tmp_path: Path) -> None:
    opened(data, tmp_path)
    (labels,) = tmp_path.glob("*/labels.npz")
    labels.write_bytes(labels.read_bytes()[:40])
    with pytest.raises(WorldError, match=r"is damaged .* delete that folder"):
        opened(data, tmp_path)


def test_damaged_episode_leaves_no_cache_behind(tmp_path: Path) -> None:
    make_dataset(tmp_path / "data", 2)
    path = tmp_path / "data" / "episodes" / "ep_000002.zip"
    path.write_bytes(path.read_bytes()[:-200])
    with pytest.raises(ArchiveCorrupt, match="ep_000002"):
        opened(Dataset(tmp_path / "data"), tmp_path / "cache")
    assert [path.suffix for path in (tmp_path / "cache").iterdir()] == [".lock"]


def test_the_second_process_waits_for_the_cache_and_decodes_no_frame(data: Dataset, tmp_path: Path) -> None:
    is_started, may_go_on, first, second = threading.Event(), threading.Event(), [], []

    def tell_and_hold(done: int, of: int) -> None:
        first.append((done, of))
        is_started.set()
        assert may_go_on.wait(60)

    with ThreadPoolExecutor(2) as pool:
        maker = pool.submit(open_cache, data, SIZE, HOLD, "braking", tmp_path, tell_and_hold)
        assert is_started.wait(60)
        waiter = pool.submit(
            open_cache, data, SIZE, HOLD, "braking", tmp_path, lambda done, of: second.append((done, of))
        )
        with pytest.raises(TimeoutError):
            waiter.result(1.0)
        may_go_on.set()
        made, found = maker.result(60), waiter.result(60)
    assert first == [(1, 2), (2, 2)]
    assert set(second) == {(0, 2)}
    assert np.array_equal(made.pictures.rgb, found.pictures.rgb)


def test_an_empty_selection_is_refused(data: Dataset, tmp_path: Path) -> None:
    with pytest.raises(UsageError, match="has no episodes of this split, scene and tier"):
        opened(data.filter(split="test_ood_obj"), tmp_path)
