"""Clips of several frames, and the arguments of datasets of frames and clips."""

from __future__ import annotations

import pickle
from typing import Any

import numpy as np
import pytest

from factory.dataset.reader import Dataset
from factory.dataset.rendering import mean_of_blocks, middle_of_blocks, shrink_frame
from factory.dataset.torch import ClipDataset, FrameDataset, collate
from schemas.frame import Frame
from tests.builders.bundle import parts_for
from tests.builders.dataset import make_dataset


@pytest.fixture(scope="module")
def dataset(tmp_path_factory: pytest.TempPathFactory) -> Dataset:
    """Three episodes of twelve steps."""
    root = tmp_path_factory.mktemp("clips") / "data"
    make_dataset(root, 3)
    return Dataset(root)


def test_a_clip_has_frames_of_one_episode(dataset: Dataset) -> None:
    clips = ClipDataset(dataset, 4, stride=2, every=3, with_ids=True)
    assert len(clips) == 6
    found = [(clips[n]["episode_id"], np.asarray(clips[n]["step"]).tolist()) for n in (0, 1, 2, -1)]
    assert found == [
        ("ep_000001", [0, 2, 4, 6]),
        ("ep_000001", [3, 5, 7, 9]),
        ("ep_000002", [0, 2, 4, 6]),
        ("ep_000003", [3, 5, 7, 9]),
    ]
    parts, clip = parts_for(), clips[1]
    for k, t in enumerate((3, 5, 7, 9)):
        for name, image in zip(("rgb", "depth", "ids"), parts.frames[t], strict=True):
            assert np.array_equal(clip[name][k], image)  # type: ignore[literal-required]
    assert np.array_equal(clip["action"], parts.arrays.actions_continuous[[3, 5, 7, 9]])
    assert np.array_equal(clip["tokens"], parts.arrays.actions_tokens[[3, 5, 7, 9]])


def test_episodes_shorter_than_a_clip_have_no_sample(dataset: Dataset) -> None:
    assert len(ClipDataset(dataset, 12)) == 3
    assert len(ClipDataset(dataset, 13)) == len(ClipDataset(dataset, 3, stride=6)) == 0
    with pytest.raises(IndexError, match="index 0 is out of range for 0 clips"):
        ClipDataset(dataset, 13)[0]


def test_a_batch_of_clips_is_collated_without_a_copy(dataset: Dataset) -> None:
    torch = pytest.importorskip("torch")
    clips = ClipDataset(dataset, 3, every=4, threads=2)
    batch = clips.__getitems__([0, 4, 2])
    theirs = torch.utils.data.default_collate(list(batch))
    ours = collate(batch)
    assert ours.keys() == theirs.keys()
    for name, wanted in theirs.items():
        assert torch.equal(ours[name], wanted) if torch.is_tensor(wanted) else ours[name] == wanted
    assert ours["rgb"].shape == (3, 3, 640, 640, 3)
    assert ours["rgb"].data_ptr() == batch.images["rgb"].ctypes.data


def test_clips_can_be_pickled_while_open(dataset: Dataset) -> None:
    clips = ClipDataset(dataset, 2)
    first = clips[0]["rgb"]
    assert np.array_equal(pickle.loads(pickle.dumps(clips))[0]["rgb"], first)


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        ({"length": 0}, "length 0: must be at least 1"),
        ({"every": 0}, "every 0: must be at least 1"),
        ({"size": 0}, "size 0: must be at least 1"),
        ({"antialias": 0}, "antialias 0: must be at least 1"),
        ({"size": 1024, "antialias": 3}, "size 1024 with antialias 3: their product must be at most 2048"),
    ],
)
def test_the_error_of_a_wrong_argument_states_its_value(dataset: Dataset, wrong: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        ClipDataset(dataset, **{"length": 2, **wrong})
    if "size" in wrong or "antialias" in wrong:
        with pytest.raises(ValueError, match=message):
            FrameDataset(dataset, **wrong)


def test_colours_of_a_block_are_averaged_and_depth_and_ids_are_not() -> None:
    rng = np.random.default_rng(0)
    rgb = rng.integers(0, 256, (12, 12, 3), dtype=np.uint8)
    depth, ids = rng.random((12, 12), np.float32), rng.integers(0, 9, (12, 12), dtype=np.uint16)
    small = shrink_frame(Frame(rgb, depth, ids), 3)
    means = rgb.reshape(4, 3, 4, 3, 3).mean(axis=(1, 3))
    assert np.abs(small.rgb - means).max() < 1
    assert np.array_equal(small.depth, depth[1::3, 1::3])
    assert np.array_equal(small.ids, ids[1::3, 1::3])
    assert small.rgb.flags.writeable
    assert small.depth.flags.c_contiguous


def test_blocks_of_one_pixel_change_nothing() -> None:
    rgb = np.arange(48, dtype=np.uint8).reshape(4, 4, 3)
    assert np.array_equal(mean_of_blocks(rgb, 1), rgb)
    assert np.array_equal(middle_of_blocks(rgb[:, :, 0], 1), rgb[:, :, 0])
