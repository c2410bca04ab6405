"""The reader of a dataset: as a sequence, across processes, and with damaged data."""

from __future__ import annotations

import json
import multiprocessing
import pickle
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import pytest

import factory
from factory.dataset import parallel
from factory.dataset.reader import Dataset, Episode
from factory.dataset.torch import FrameDataset, collate
from schemas.dataset.meta import DATASET_FORMAT
from schemas.errors import ArchiveCorrupt, UsageError, WorldError
from tests.builders.bundle import parts_for
from tests.builders.dataset import make_dataset
from tests.builders.fresh_process import in_fresh_process


@pytest.fixture(scope="module")
def shared(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A dataset that no test changes."""
    root = tmp_path_factory.mktemp("shared") / "data"
    make_dataset(root, 3)
    return root


@pytest.fixture
def own(tmp_path: Path) -> Path:
    """A dataset that the test may damage."""
    make_dataset(tmp_path / "data", 2)
    return tmp_path / "data"


def mean_of_frame(episode: Episode) -> float:
    return float(episode.rgb(3).mean())


def test_dataset_is_a_sequence_of_episodes(shared: Path) -> None:
    data = Dataset(shared)
    assert len(data) == 3
    assert [episode.episode_id for episode in data] == ["ep_000001", "ep_000002", "ep_000003"]
    assert data[-1].episode_id == data["ep_000003"].episode_id == "ep_000003"
    assert "3 episodes" in repr(data)


def test_episode_gives_what_was_recorded(shared: Path) -> None:
    parts = parts_for()
    with Dataset(shared)[0] as episode:
        assert episode.instruction == "Go to the chair."
        assert len(episode) == 12
        assert np.array_equal(episode.actions, parts.arrays.actions_continuous)
        assert np.array_equal(episode.tokens, parts.arrays.actions_tokens)
        assert np.array_equal(episode.poses, parts.arrays.poses)
        assert episode.meta.episode_id == "ep_000001"
        for found, written in zip(episode.frames(), parts.frames, strict=True):
            assert all(np.array_equal(one, two) for one, two in zip(found, written, strict=True))


def test_a_negative_step_counts_from_the_end_and_a_step_beyond_the_end_is_refused(shared: Path) -> None:
    episode = Dataset(shared)[0]
    assert np.array_equal(episode.frame(-1).rgb, episode.frame(11).rgb)
    with pytest.raises(IndexError, match="ep_000001 has steps 0 to 11, not 12"):
        episode.rgb(12)


def test_unknown_episodes_are_named(shared: Path) -> None:
    data = Dataset(shared)
    with pytest.raises(KeyError, match="ep_000009 is not one of the 3 selected episodes"):
        data["ep_000009"]
    with pytest.raises(IndexError, match="index 3 is out of range for 3 episodes"):
        data[3]


def test_filters_select_episodes_and_can_be_combined(shared: Path) -> None:
    data = Dataset(shared)
    assert len(data.filter(split="train_id", scene="office", tier=("near", "mid"), category="chair")) == 3
    assert len(data.filter(tier="far")) == 0
    assert [episode.episode_id for episode in data.filter(episode=["ep_000002"])] == ["ep_000002"]
    with pytest.raises(UsageError, match="unknown filter 'colour_word'; valid filters: split, scene"):
        data.filter(colour_word="red")


@pytest.mark.parametrize(
    ("wanted", "said"),
    [
        ({"split": "bogus"}, "unknown split 'bogus'; valid values: train_id, val_id, test_id"),
        ({"scene": "offfice"}, "unknown scene 'offfice'; valid values: office, .*; did you mean 'office'"),
        ({"tier": ("near", "Far")}, "unknown tier 'Far'; valid values: near, mid, far; did you mean 'far'"),
        ({"category": "chairs"}, "unknown category 'chairs'; .*; did you mean 'chair'"),
        ({"target": "chair_1"}, "unknown target 'chair_1'; valid values: chair_001; did you mean 'chair_001'"),
        ({"template": "train_19"}, "unknown template 'train_19'; .*ood_06 and 6 more"),
        ({"colour": "grey"}, "unknown colour 'grey'; .*; did you mean 'gray'"),
        ({"expert": "plan"}, "unknown expert 'plan'; .*; did you mean 'planner'"),
        ({"episode": "1"}, "unknown episode '1'; valid values: ep_000001"),
        ({"episode": "ep_000004"}, "unknown episode 'ep_000004'; valid values: ep_000001, ep_000002, ep_000003"),
    ],
)
def test_impossible_filter_values_are_named(shared: Path, wanted: dict[str, str], said: str) -> None:
    with pytest.raises(UsageError, match=said):
        Dataset(shared).filter(**wanted)


@pytest.mark.parametrize(
    "wanted",
    [
        {"split": "test_ood_obj"},
        {"scene": "hospital"},
        {"tier": "far"},
        {"category": "sofa"},
        {"target": "sofa_012"},
        {"template": "ood_12"},
        {"colour": "unknown"},
        {"expert": "planner"},
        {"split": ()},
    ],
)
def test_a_valid_filter_may_select_nothing(shared: Path, wanted: dict[str, str]) -> None:
    part = Dataset(shared).filter(**wanted)
    assert len(part) == 0
    assert len(part.filter(episode="ep_000002", target="chair_001")) == 0


def test_the_digest_equals_the_one_in_the_description(shared: Path) -> None:
    data = Dataset(shared)
    assert data.digest == data.meta.dataset_digest
    assert data.filter(episode="ep_000001").digest != data.digest


def test_open_episode_can_be_pickled(shared: Path) -> None:
    episode = Dataset(shared)[1]
    before = episode.rgb(3)
    copy = pickle.loads(pickle.dumps(episode))
    assert np.array_equal(copy.rgb(3), before)


def read_in_other_processes(path: Path, method: str) -> None:
    episode = Dataset(path)[0]
    expected = mean_of_frame(episode)
    with multiprocessing.get_context(method).Pool(2) as pool:
        assert pool.map(mean_of_frame, [episode] * 4) == [expected] * 4


@pytest.mark.parametrize("method", ["fork", "spawn"])
def test_open_episode_can_be_used_in_another_process(shared: Path, method: str) -> None:
    in_fresh_process(read_in_other_processes, shared, method)


def test_closed_episode_opens_again(shared: Path) -> None:
    episode = Dataset(shared)[0]
    first = episode.rgb(0)
    episode.close()
    assert np.array_equal(episode.rgb(0), first)


def test_missing_file_is_named(own: Path) -> None:
    (own / "episodes/ep_000001.zip").unlink()
    with pytest.raises(ArchiveCorrupt, match=r"ep_000001\.zip is missing: run `factory verify`"):
        Dataset(own)[0].rgb(0)


def test_damaged_file_is_named(own: Path) -> None:
    path = own / "episodes/ep_000001.zip"
    path.write_bytes(path.read_bytes()[:-10])
    with pytest.raises(ArchiveCorrupt, match=r"ep_000001\.zip is damaged .*run `factory verify --deep`"):
        _ = Dataset(own)[0].actions


def test_damaged_frame_is_named_and_the_others_can_be_read(own: Path) -> None:
    path = own / "episodes/ep_000001.zip"
    data = bytearray(path.read_bytes())
    data[data.index(b"rgb_front/000003.png") + 200] ^= 1
    path.write_bytes(data)
    episode = Dataset(own)[0]
    assert episode.rgb(2).shape == (640, 640, 3)
    with pytest.raises(ArchiveCorrupt, match=r"ep_000001\.zip is damaged \(rgb_front/000003\.png"):
        episode.rgb(3)


def test_a_forged_number_of_steps_allocates_no_memory(own: Path) -> None:
    true = Dataset(own)[0]
    false = Episode(true.path, true.summary.model_copy(update={"num_steps": 10**9}))
    with pytest.raises(ArchiveCorrupt, match="has 12 steps, the metadata has 1000000000"):
        false.rgb(0)


def test_swapped_file_is_noticed(own: Path) -> None:
    (own / "episodes/ep_000001.zip").write_bytes(parts_for(steps=13).write())
    with pytest.raises(ArchiveCorrupt, match="has 13 steps, the metadata has 12"):
        Dataset(own)[0].rgb(0)


def test_directory_without_a_dataset_is_named(tmp_path: Path) -> None:
    with pytest.raises(WorldError, match="is not a dataset"):
        Dataset(tmp_path)


def test_the_error_of_a_newer_dataset_names_its_format(own: Path) -> None:
    path = own / "dataset_meta.json"
    path.write_text(json.dumps(json.loads(path.read_text()) | {"format": 9}))
    with pytest.raises(WorldError, match=f"dataset format 9, this software reads up to {DATASET_FORMAT}: upgrade"):
        Dataset(own)


@pytest.mark.parametrize("text", [b"", b"PAR1", b"rubbish" * 100])
def test_damaged_metadata_is_named(own: Path, text: bytes) -> None:
    (own / "metadata.parquet").write_bytes(text)
    with pytest.raises(ArchiveCorrupt, match=r"metadata\.parquet is damaged"):
        Dataset(own)


def test_importing_the_package_loads_no_heavy_dependency() -> None:
    script = "import sys, factory; print('pyarrow' in sys.modules, 'numpy' in sys.modules, factory.Dataset.__name__)"
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True)
    assert done.stdout.split() == ["False", "False", "Dataset"]
    with pytest.raises(AttributeError, match="no attribute 'Dataest'"):
        _ = factory.Dataest


_FAULTS = """
import resource, sys
from factory.dataset.reader import Dataset

frames = [(episode, t) for episode in Dataset(sys.argv[1]) for t in range(len(episode))]
for episode, t in frames:
    episode.frame(t)
before = resource.getrusage(resource.RUSAGE_SELF).ru_minflt
for episode, t in frames:
    frame = episode.frame(t)
print((resource.getrusage(resource.RUSAGE_SELF).ru_minflt - before) / len(frames))
"""


def test_the_memory_of_a_frame_is_reused_for_the_next_one(shared: Path) -> None:
    """A frame has about 900 pages, each of which would cause a page fault if its memory were returned to the system."""
    done = subprocess.run([sys.executable, "-c", _FAULTS, str(shared)], capture_output=True, text=True, check=True)
    assert float(done.stdout) < 150


def test_a_frame_dataset_iterates_over_all_frames(shared: Path) -> None:
    samples = FrameDataset(Dataset(shared))
    assert len(samples) == 36
    seen = [(samples[n]["episode_id"], samples[n]["step"]) for n in (0, 11, 12, 35, -1)]
    assert seen == [("ep_000001", 0), ("ep_000001", 11), ("ep_000002", 0), ("ep_000003", 11), ("ep_000003", 11)]
    with pytest.raises(IndexError, match="index 36 is out of range for 36 frames"):
        samples[36]


def test_frame_sample_holds_one_step(shared: Path) -> None:
    parts = parts_for()
    sample = FrameDataset(Dataset(shared), with_ids=True)[5]
    assert np.array_equal(sample["rgb"], parts.frames[5][0])
    assert np.array_equal(sample["depth"], parts.frames[5][1])
    assert np.array_equal(sample["ids"], parts.frames[5][2])
    assert np.array_equal(sample["action"], parts.arrays.actions_continuous[5])
    assert np.array_equal(sample["tokens"], parts.arrays.actions_tokens[5])
    assert all(sample[name].flags.writeable for name in ("rgb", "depth", "ids", "action", "tokens"))  # type: ignore[literal-required]


def test_frame_dataset_with_a_stride_keeps_every_nth_frame(shared: Path) -> None:
    samples = FrameDataset(Dataset(shared), stride=5)
    assert len(samples) == 9
    assert [samples[n]["step"] for n in range(4)] == [0, 5, 10, 0]


def test_a_batch_decoded_in_threads_has_the_samples_that_are_decoded_one_by_one(
    shared: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(parallel, "MOST_OPEN", 1)  # three episodes are open while the batch is read
    one, many = (FrameDataset(Dataset(shared), with_ids=True, threads=threads) for threads in (1, 4))
    indices = [5, 30, 17, 5, 0, -1, 12]
    batch = many.__getitems__(indices)
    assert [(sample["episode_id"], sample["step"]) for sample in batch] == [
        (one[n]["episode_id"], one[n]["step"]) for n in indices
    ]
    for number, index in enumerate(indices):
        for name in ("rgb", "depth", "ids", "action", "tokens"):
            assert np.array_equal(batch[number][name], one[index][name])  # type: ignore[literal-required]
        assert np.shares_memory(batch[number]["rgb"], batch.images["rgb"])


def test_collation_gives_the_batch_of_the_default_collation_of_torch(shared: Path) -> None:
    torch = pytest.importorskip("torch")
    batch = FrameDataset(Dataset(shared), with_ids=True).__getitems__([3, 20, 14])
    theirs = torch.utils.data.default_collate(list(batch))
    for ours in (collate(batch), collate(list(batch))):
        assert ours.keys() == theirs.keys()
        for name, wanted in theirs.items():
            assert torch.equal(ours[name], wanted) if torch.is_tensor(wanted) else ours[name] == wanted
    assert collate(batch)["rgb"].data_ptr() == batch.images["rgb"].ctypes.data


def test_threads_may_share_an_episode(shared: Path) -> None:
    """A file has one position: if threads move it concurrently, they read wrong bytes and report false damage."""
    episode = Dataset(shared)[0]
    wanted = [frame[0] for frame in parts_for().frames]
    with ThreadPoolExecutor(8) as pool:
        seen = list(pool.map(episode.rgb, [t for _ in range(20) for t in range(len(episode))]))
    assert all(np.array_equal(image, wanted[n % len(episode)]) for n, image in enumerate(seen))


def test_zero_threads_are_refused(shared: Path) -> None:
    with pytest.raises(ValueError, match="threads 0: must be at least 1"):
        FrameDataset(Dataset(shared), threads=0)


def test_frame_dataset_can_be_pickled_while_open(shared: Path) -> None:
    samples = FrameDataset(Dataset(shared))
    first = samples[0]["rgb"]
    assert np.array_equal(pickle.loads(pickle.dumps(samples))[0]["rgb"], first)
