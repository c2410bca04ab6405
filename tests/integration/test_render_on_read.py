"""Frames of a states recording: rendered when they are read, equal to those of a frames recording, bit for bit."""

from __future__ import annotations

import multiprocessing
import os
import shutil
import subprocess
import sys
from concurrent.futures import ProcessPoolExecutor, ThreadPoolExecutor
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest
from PIL import Image

from coordinator.tables.split_tables import find_faults
from factory.dataset.reader import Dataset
from factory.dataset.sampler import SceneSampler
from factory.dataset.torch import ClipDataset, FrameDataset, collate
from factory.eval.specs.from_dataset import specs_of_dataset
from schemas.errors import UsageError
from schemas.storage.dataset_files import SCENES
from schemas.storage.place import digest_of
from schemas.terms import Recording, Split
from tests.acceptance.factory_cli import Command
from tests.builders.fresh_process import in_fresh_process

pytestmark = pytest.mark.gl


@pytest.fixture
def frames(recordings: dict[Recording, Path]) -> Dataset:
    return Dataset(recordings[Recording.FRAMES])


@pytest.fixture
def states(recordings: dict[Recording, Path]) -> Dataset:
    return Dataset(recordings[Recording.STATES])


def test_rendered_frames_equal_the_stored_ones(frames: Dataset, states: Dataset) -> None:
    for stored, rendered in zip(frames, states, strict=True):
        assert np.array_equal(stored.poses, rendered.poses)
        for t in (0, 7, len(stored) // 2, -1):
            for one, other in zip(stored.frame(t), rendered.frame(t), strict=True):
                assert one.dtype == other.dtype
                assert np.array_equal(one, other)
            assert np.array_equal(stored.rgb(t), rendered.rgb(t))
            assert np.array_equal(stored.depth(t), rendered.depth(t))
            assert np.array_equal(stored.ids(t), rendered.ids(t))


def test_rendered_members_are_the_stored_bytes(frames: Dataset, states: Dataset) -> None:
    for kind in ("rgb_front/000003.png", "depth_front/000003.npy.zst", "seg_front/000003.png", "poses.npy"):
        assert frames[0].stored(kind) == states[0].stored(kind)


def test_instances_come_from_the_scene(frames: Dataset, states: Dataset) -> None:
    assert states[0].meta.instances == ()
    assert states[0].instances == frames[0].instances != ()


def test_changes_to_a_returned_frame_do_not_change_the_next_reading(states: Dataset) -> None:
    episode = states[0]
    whole = episode.frame(5).rgb.copy()
    for read in (lambda: episode.frame(5).rgb, lambda: episode.rgb(5)):
        read()[:] = 0
        assert np.array_equal(read(), whole)


def test_frames_of_another_size_are_rendered_for_both_recordings(frames: Dataset, states: Dataset) -> None:
    small = [next(data[0].frames(size=64)) for data in (frames, states)]
    assert small[0].rgb.shape == (64, 64, 3)
    for one, other in zip(*small, strict=True):
        assert np.array_equal(one, other)


def test_every_nth_frame_is_read(states: Dataset) -> None:
    steps = range(0, len(states[0]), 40)
    for t, frame in zip(steps, states[0].frames(stride=40), strict=True):
        assert np.array_equal(frame.rgb, states[0].rgb(t))


def test_threads_read_the_right_frames(frames: Dataset, states: Dataset) -> None:
    places = [(number, t) for t in range(0, 60, 10) for number in (0, 1)]
    with ThreadPoolExecutor(4) as pool:
        found = list(pool.map(lambda place: states[place[0]].rgb(place[1]), places))
    for (number, t), rgb in zip(places, found, strict=True):
        assert np.array_equal(rgb, frames[number].rgb(t))


def depth_of(episode: object, t: int) -> np.ndarray:
    return episode.depth(t)  # type: ignore[attr-defined,no-any-return]


def render_here_and_there(frames: Dataset, states: Dataset, method: str) -> None:
    states[0].rgb(0)
    with ProcessPoolExecutor(1, mp_context=multiprocessing.get_context(method)) as pool:
        found = pool.submit(depth_of, states[1], 4).result()
    assert np.array_equal(found, frames[1].depth(4))
    assert np.array_equal(states[1].depth(4), found)  # this process can still render


@pytest.mark.parametrize("method", ["fork", "spawn"])
def test_processes_render_after_their_parent_has_rendered(frames: Dataset, states: Dataset, method: str) -> None:
    in_fresh_process(render_here_and_there, frames, states, method)


def test_training_samples_of_both_recordings_are_equal(frames: Dataset, states: Dataset) -> None:
    picks = [0, 45, 3, 100]
    for one, other in zip(
        FrameDataset(frames, with_ids=True).__getitems__(picks),
        FrameDataset(states, with_ids=True).__getitems__(picks),
        strict=True,
    ):
        for name in one:
            assert np.array_equal(one[name], other[name])  # type: ignore[literal-required]


def test_evaluation_specs_of_both_recordings_are_equal(frames: Dataset, states: Dataset) -> None:
    found = [specs_of_dataset(data, [Split.TRAIN_ID]) for data in (frames, states)]
    assert found[0].specs == found[1].specs


def test_the_tables_of_a_states_dataset_have_no_thumbnails_and_no_faults(states: Dataset) -> None:
    (table,) = Path(str(states.root)).glob("data/*.parquet")
    assert "thumbnail" not in pq.read_table(table).column_names
    assert list(find_faults(states.root, deep=True)) == []
    card = (Path(str(states.root)) / "README.md").read_text()
    assert '["thumbnail"]' not in card
    assert "This dataset records states" in card
    assert "rgb_front" not in card


def test_the_card_names_the_software_that_gives_identical_frames(states: Dataset) -> None:
    card = (Path(str(states.root)) / "README.md").read_text()
    fingerprint = states[0].meta.provenance.fingerprint
    versions = fingerprint.software["minivla-factory"], fingerprint.software["libc"]
    assert f"| {fingerprint.renderer} | {versions[0]} | {versions[1]} | x86_64 |" in card


def test_a_contact_sheet_of_both_recordings_is_equal(
    command: Command, recordings: dict[Recording, Path], tmp_path: Path
) -> None:
    pictures = []
    for record, root in recordings.items():
        command("show", root, 1, "-o", tmp_path / f"{record}.png")
        pictures.append(np.asarray(Image.open(tmp_path / f"{record}.png")))
    assert np.array_equal(*pictures)


@pytest.fixture
def copied(states: Dataset, tmp_path: Path) -> Path:
    shutil.copytree(str(states.root), tmp_path / "states")
    return tmp_path / "states"


def read_in_new_process(root: Path, **environment: str) -> str:
    """Returns the error of reading a frame in a process that has no decoded scenes; empty if there was none."""
    code = f"from minivla import Dataset\nprint(Dataset({str(root)!r})[0].frame(1).rgb.shape)"
    command = [sys.executable, "-c", code]
    done = subprocess.run(command, env=os.environ | environment, capture_output=True, text=True, check=False)
    return done.stderr if done.returncode else ""


def test_an_edited_scene_is_refused_with_both_digests_and_the_searched_folders(copied: Path, states: Dataset) -> None:
    package = next((copied / SCENES).glob("*.scene.zip"))
    package.write_bytes(package.read_bytes() + b"x")
    error = read_in_new_process(copied)
    assert f"the package of scene box_room with SHA-256 {states[0].summary.scene_sha256} is missing" in error
    assert f"{package} has SHA-256 {digest_of(package)}; searched: {copied / SCENES}" in error


def test_a_missing_scene_is_found_in_a_folder_of_the_search_path(copied: Path, tmp_path: Path) -> None:
    (copied / SCENES).rename(tmp_path / "elsewhere")
    folders = f"{tmp_path}{os.pathsep}{tmp_path / 'elsewhere'}"
    assert "no package of scene box_room was found" in read_in_new_process(copied)
    assert read_in_new_process(copied, MINIVLA_SCENES=folders) == ""


def test_an_unknown_renderer_is_refused_by_name(states: Dataset, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("MINIVLA_RENDERER", "vulkan")
    with pytest.raises(UsageError, match="vulkan"):
        states[0].frame(0)


def test_without_egl_the_message_names_the_remedy(states: Dataset) -> None:
    error = read_in_new_process(Path(str(states.root)), __EGL_VENDOR_LIBRARY_DIRS="/nowhere")
    assert "OpenGL 4.5 with EGL is not available on this machine" in error
    assert "apt-get install libegl1 libgl1-mesa-dri" in error


def test_training_samples_of_another_size_are_equal_for_both_recordings(frames: Dataset, states: Dataset) -> None:
    options: dict[str, int] = {"size": 48, "antialias": 2}
    picks = [0, 45, 3, 100]
    both = [FrameDataset(data, with_ids=True, **options).__getitems__(picks) for data in (frames, states)]
    for one, other in zip(*both, strict=True):
        assert one["rgb"].shape == (48, 48, 3)
        for name in one:
            assert np.array_equal(one[name], other[name])  # type: ignore[literal-required]
    frame = states[0].frame(3, **options)
    large = states[0].frame(3, size=96)
    assert np.array_equal(both[1][2]["rgb"], frame.rgb)
    assert np.array_equal(frame.rgb, np.asarray(Image.fromarray(large.rgb).reduce(2)))
    assert np.array_equal(frame.depth, large.depth[1::2, 1::2])
    assert np.array_equal(frame.ids, large.ids[1::2, 1::2])


def test_clips_of_both_recordings_are_equal(frames: Dataset, states: Dataset) -> None:
    one, other = (ClipDataset(data, 3, stride=5, size=32).__getitems__([0, 60]) for data in (frames, states))
    for clip, same in zip(one, other, strict=True):
        assert clip["rgb"].shape == (3, 32, 32, 3)
        for name in clip:
            assert np.array_equal(clip[name], same[name])  # type: ignore[literal-required]


def test_a_frame_that_is_too_large_is_refused(states: Dataset) -> None:
    with pytest.raises(UsageError, match="frame size 2560 is not valid: choose 1 to 2048 pixels"):
        states[0].frame(0, antialias=4)


def render_in_a_loader(states: Dataset, method: str) -> None:
    import torch

    source = FrameDataset(states, size=32, stride=40)
    order = SceneSampler(source, seed=3)
    alone = [source[index] for index in order]
    loader = torch.utils.data.DataLoader(
        source, 2, sampler=order, num_workers=2, multiprocessing_context=method, collate_fn=collate
    )
    found = [image for batch in loader for image in batch["rgb"].numpy()]
    assert len(found) == len(source)
    assert all(np.array_equal(image, sample["rgb"]) for image, sample in zip(found, alone, strict=True))


@pytest.mark.parametrize("method", ["fork", "spawn"])
def test_worker_processes_of_a_loader_render(states: Dataset, method: str) -> None:
    pytest.importorskip("torch")
    in_fresh_process(render_in_a_loader, states, method)
