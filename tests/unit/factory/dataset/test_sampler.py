"""Order of training samples: every sample once per epoch, with few scenes at a time."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Iterable, Sequence
from itertools import chain, pairwise
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from factory.dataset import sampler
from factory.dataset.reader import Dataset
from factory.dataset.sampler import SceneSampler, shuffle_by_scene
from factory.dataset.torch import ClipDataset, FrameDataset
from schemas.job import episode_id
from schemas.storage.dataset_files import METADATA_FILE
from tests.builders.dataset import make_dataset

STEPS = (7, 3, 9, 1, 5, 4)


@pytest.fixture
def dataset(tmp_path: Path) -> Dataset:
    """A table of 60 episodes in 30 scenes; their files do not exist."""
    make_dataset(tmp_path / "data", 1)
    path = tmp_path / "data" / METADATA_FILE
    (row,) = pq.read_table(path).to_pylist()
    rows = [
        {
            **row,
            "index": number,
            "episode_id": episode_id(number),
            "num_steps": steps,
            "scene_sha256": f"{number % 30:064}",
        }
        for number, steps in enumerate([*STEPS] * 10, 1)
    ]
    pq.write_table(pa.Table.from_pylist(rows, schema=pq.read_schema(path)), path)
    return Dataset(tmp_path / "data")


@pytest.fixture
def frames(dataset: Dataset) -> FrameDataset:
    return FrameDataset(dataset)


def scenes_of(samples: ClipDataset, order: Iterable[int]) -> list[int]:
    owner = np.repeat(np.arange(60), samples.counts)
    return [int(owner[index]) % 30 for index in order]


def count_loads(scenes: Sequence[int], kept: int) -> int:
    """Returns how many times a renderer that keeps `kept` scenes prepares a scene."""
    cache: OrderedDict[int, None] = OrderedDict()
    loads = 0
    for scene in scenes:
        loads += scene not in cache
        cache[scene] = None
        cache.move_to_end(scene)
        while len(cache) > kept:
            cache.popitem(last=False)
    return loads


def test_every_sample_is_used_once_in_each_epoch(frames: FrameDataset) -> None:
    found = SceneSampler(frames)
    for epoch in range(3):
        found.set_epoch(epoch)
        assert sorted(found) == list(range(len(frames)))
        assert len(found) == len(frames) == 290


def test_each_scene_is_prepared_once_in_an_epoch(frames: FrameDataset) -> None:
    order = scenes_of(frames, SceneSampler(frames, scenes=4))
    assert count_loads(order, kept=4) == 30
    assert count_loads(scenes_of(frames, np.random.default_rng(0).permutation(290)), kept=4) > 200


def test_the_scenes_of_a_window_alternate_and_windows_differ_between_epochs(frames: FrameDataset) -> None:
    windows = []
    found = SceneSampler(frames, scenes=4)
    for epoch in range(2):
        found.set_epoch(epoch)
        order = scenes_of(frames, found)
        windows.append(set(order[:20]))
        assert len(set(order[:20])) == 4
        assert sum(one != other for one, other in pairwise(order)) > 150
    assert windows[0] != windows[1]


def test_seed_and_epoch_determine_the_order(frames: FrameDataset) -> None:
    first, same, other = SceneSampler(frames, seed=1), SceneSampler(frames, seed=1), SceneSampler(frames, seed=2)
    assert list(first) == list(same) != list(other)
    first.set_epoch(1)
    assert list(first) != list(same)


@pytest.mark.parametrize("replicas", [2, 3, 7])
def test_the_ranks_of_a_distributed_training_share_the_samples(frames: FrameDataset, replicas: int) -> None:
    parts = [SceneSampler(frames, rank=rank, replicas=replicas) for rank in range(replicas)]
    orders = [list(part) for part in parts]
    assert list(chain(*orders)) == list(SceneSampler(frames))
    assert [len(order) for order in orders] == [len(part) for part in parts]
    assert max(map(len, orders)) - min(map(len, orders)) <= 1
    even = [list(SceneSampler(frames, rank=rank, replicas=replicas, even=True)) for rank in range(replicas)]
    assert {len(order) for order in even} == {290 // replicas}
    assert len(set(chain(*even))) == 290 // replicas * replicas


def test_a_resumed_epoch_continues_after_the_finished_samples(frames: FrameDataset) -> None:
    whole, resumed = (SceneSampler(frames, rank=1, replicas=2) for _ in range(2))
    whole.set_epoch(4)
    resumed.set_epoch(4, done=32)
    assert list(resumed) == list(whole)[32:]
    assert len(resumed) == len(whole) - 32
    resumed.set_epoch(5)
    assert len(resumed) == len(whole)


def test_large_windows_are_shuffled_in_buffers_of_whole_episodes(
    frames: FrameDataset, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(sampler, "_BUFFER_SAMPLES", 25)
    owner = np.repeat(np.arange(60), frames.counts)
    order = [int(owner[index]) for index in SceneSampler(frames, scenes=30)]
    assert sorted(order) == sorted(owner.tolist())
    reach = [max(np.flatnonzero(np.array(order) == one)) - order.index(one) for one in range(60)]
    assert max(reach) < 60


def test_the_sampler_counts_clips_and_not_frames(dataset: Dataset) -> None:
    clips = ClipDataset(dataset, 3, stride=2)
    assert clips.counts[:6].tolist() == [3, 0, 5, 0, 1, 0]
    assert sorted(SceneSampler(clips)) == list(range(len(clips)))


def test_the_samples_of_few_scenes_are_shuffled_together() -> None:
    scenes = np.array([0, 1, 2, 0, 1, 3])
    (window,) = shuffle_by_scene(scenes, np.random.default_rng(5))
    assert np.array_equal(window, np.random.default_rng(5).permutation(6))


def test_a_dataset_without_samples_has_an_empty_order(dataset: Dataset) -> None:
    assert list(SceneSampler(FrameDataset(dataset.filter(split="test_ood_obj")))) == []


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        ({"scenes": 0}, "scenes 0: must be at least 1"),
        ({"rank": 2, "replicas": 2}, "rank 2 with replicas 2: choose 0 to 1"),
    ],
)
def test_the_error_of_a_wrong_argument_states_its_value(
    frames: FrameDataset, wrong: dict[str, int], message: str
) -> None:
    with pytest.raises(ValueError, match=message):
        SceneSampler(frames, **wrong)
