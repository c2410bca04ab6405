"""Training on a states dataset: frames are rendered in memory, are not stored, and equal those of a frames dataset."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from factory.dataset.reader import Dataset
from factory.train.frames import PictureSource, TrainingFrames
from factory.train.pictures import open_cache, render_frames
from schemas.errors import UsageError
from schemas.terms import Recording
from tests.builders.needs_torch import needs_torch
from tests.integration.test_train import options, train, weights

pytestmark = [
    pytest.mark.gl,
    # torch 2.13 warns about a deprecated Python feature that it uses
    pytest.mark.filterwarnings("ignore::DeprecationWarning", "ignore::FutureWarning"),
]
SIZE, HOLD = 64, 12
Recordings = dict[Recording, Path]


def rendered(root: Path, antialias: int | None = None, memory_bytes: int = 1 << 28) -> TrainingFrames:
    return render_frames(Dataset(root), SIZE, HOLD, "success", antialias, memory_bytes, lambda _done, _of: None)


def taken(source: PictureSource, rows: np.ndarray) -> list[np.ndarray]:
    return list(source.take(rows))


@pytest.fixture
def stored(recordings: Recordings, tmp_path: Path) -> TrainingFrames:
    return open_cache(
        Dataset(recordings[Recording.FRAMES]), SIZE, HOLD, "success", tmp_path / "cache", lambda _d, _of: None
    )


@pytest.mark.parametrize("memory_bytes", [0, 200_000, 1 << 28])
def test_training_frames_rendered_from_states_equal_those_of_a_frames_dataset(
    recordings: Recordings, stored: TrainingFrames, memory_bytes: int
) -> None:
    found = rendered(recordings[Recording.STATES], memory_bytes=memory_bytes)
    rows = np.random.default_rng(0).permutation(len(stored))
    for _ in range(2):  # in the second pass, frames in the memory cache are not rendered again
        for one, other in zip(taken(stored.pictures, rows), taken(found.pictures, rows), strict=True):
            assert one.dtype == other.dtype
            assert np.array_equal(one, other)
    for one, other in zip(found.labels, stored.labels, strict=True):
        assert np.array_equal(one, other)
    assert np.array_equal(found.episode, stored.episode)
    assert np.array_equal(found.scene, stored.scene)
    assert found.index.episodes == stored.index.episodes


def test_fewer_samples_per_pixel_give_similar_frames(recordings: Recordings, stored: TrainingFrames) -> None:
    rows = np.arange(0, len(stored), 5)
    exact, *others = (
        taken(source.pictures, rows)
        for source in (stored, *(rendered(recordings[Recording.STATES], samples) for samples in (1, 2)))
    )
    apart = [np.abs(exact[0].astype(float) - other[0]).mean() for other in others]
    assert 0 < apart[1] < apart[0] < 6
    assert all(np.median(np.abs(exact[1].astype(float) - other[1])) <= 20 for other in others)


@needs_torch
def test_training_on_states_gives_the_same_policy_as_training_on_frames_and_writes_no_frame(
    recordings: Recordings, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("MINIVLA_CACHE", str(tmp_path / "cache"))
    losses = train(recordings[Recording.STATES], tmp_path / "states", options(hold=HOLD))
    written = {path.suffix for path in tmp_path.rglob("*") if path.is_file()}
    assert not written & {".npy", ".npz", ".png", ".zip", ".zst"}
    assert not (tmp_path / "cache").exists()
    assert train(recordings[Recording.FRAMES], tmp_path / "frames", options(hold=HOLD)) == losses
    one, two = weights(tmp_path / "states"), weights(tmp_path / "frames")
    assert all(np.array_equal(one[name], two[name]) for name in one)


@needs_torch
def test_the_antialias_option_is_refused_for_stored_frames(recordings: Recordings, tmp_path: Path) -> None:
    with pytest.raises(UsageError, match=r"--antialias 2: .* stores frames, which are not rendered"):
        train(recordings[Recording.FRAMES], tmp_path, options(antialias=2))
