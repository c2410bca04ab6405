"""`factory verify --render`: renders recorded frames again and compares them with their digests."""

from __future__ import annotations

import io
import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from factory.dataset.reader import Dataset
from factory.verify.dataset import verify
from factory.verify.findings import Kind, VerifyReport
from schemas.bundle import BundleReader, BundleWriter
from schemas.errors import UsageError
from schemas.instruction.start_view import StartView
from schemas.plan import MAX_EPISODES
from schemas.storage.dataset_files import EPISODES, SCENES
from schemas.terms import Recording
from tests.acceptance.factory_cli import Command, FactoryCli
from tests.builders.dataset import make_dataset

pytestmark = pytest.mark.gl
Recordings = dict[Recording, Path]


def texts(report: VerifyReport, kind: Kind) -> list[str]:
    return [finding.text for finding in report.findings if finding.kind is kind]


@pytest.fixture
def copy(recordings: Recordings, tmp_path: Path) -> Callable[[Recording], Path]:
    return lambda record: Path(shutil.copytree(recordings[record], tmp_path / str(record)))


def rewrite(path: Path, brighter: int) -> None:
    """Rewrites an episode: makes frame `brighter` brighter by 1, or, without frames, makes all frame digests wrong."""
    file = io.BytesIO()
    bundle, writer = BundleReader(io.BytesIO(path.read_bytes())), BundleWriter(file)
    if bundle.has_frames:
        for t in range(bundle.length):
            rgb = bundle.rgb(t)
            writer.add_frame(np.where(rgb < 255, rgb + (t == brighter), rgb), bundle.depth(t), bundle.ids(t))
        writer.finish(bundle.arrays, bundle.meta)
    else:
        frame = np.zeros((4, 4, 3), np.uint8), np.zeros((4, 4), np.float32), np.zeros((4, 4), np.uint16)
        for _ in bundle.meta.frame_digests:
            writer.add_digest(*frame)
        writer.finish(bundle.arrays, bundle.meta)
    path.write_bytes(file.getvalue())


@pytest.mark.parametrize("record", Recording)
def test_rendered_frames_of_a_whole_dataset_have_the_recorded_digests(
    recordings: Recordings, record: Recording
) -> None:
    report = verify(recordings[record], deep=True, render=MAX_EPISODES)
    assert (report.ok, report.rendered) == (True, 2)


def test_only_the_requested_number_of_episodes_is_rendered(recordings: Recordings) -> None:
    assert verify(recordings[Recording.STATES], render=1).rendered == 1
    assert verify(recordings[Recording.STATES]).rendered == 0


def test_a_false_digest_of_a_states_recording_is_found(copy: Callable[[Recording], Path]) -> None:
    root = copy(Recording.STATES)
    rewrite(root / EPISODES / "ep_000002.zip", 0)
    (text,) = texts(verify(root, render=MAX_EPISODES), Kind.RENDERED)
    assert text.startswith("3 of 3 frames differ when they are rendered again, first frame 0; recorded with ")
    assert "rendered with " in text


def test_a_false_visibility_and_a_forbidden_start_view_of_a_states_recording_are_found(
    copy: Callable[[Recording], Path],
) -> None:
    root = copy(Recording.STATES)
    path = root / EPISODES / "ep_000001.zip"
    bundle, file = BundleReader(io.BytesIO(path.read_bytes())), io.BytesIO()
    writer = BundleWriter(file)
    for _ in bundle.meta.frame_digests:
        writer.add_digest(np.zeros((1, 1, 3), np.uint8), np.zeros((1, 1), np.float32), np.zeros((1, 1), np.uint16))
    unseen = bundle.meta.rollout.model_copy(update={"steps_visible": 0})
    job = bundle.meta.job.model_copy(update={"start_view": StartView(within_rad=0.0)})
    writer.finish(bundle.arrays, bundle.meta.model_copy(update={"rollout": unseen, "job": job}))
    path.write_bytes(file.getvalue())
    found = texts(verify(root, render=MAX_EPISODES), Kind.RENDERED)
    assert any(text.startswith("steps_visible 0, but ") for text in found)
    assert any(text.startswith("start: the target is ") for text in found)


def test_the_difference_from_stored_frames_is_reported_by_channel(copy: Callable[[Recording], Path]) -> None:
    root = copy(Recording.FRAMES)
    rewrite(root / EPISODES / "ep_000001.zip", 2)
    report = verify(root, render=MAX_EPISODES)
    (text,) = texts(report, Kind.RENDERED)
    assert text.startswith("1 of ")
    assert "first frame 2" in text
    found = report.difference.plain()
    frames = sum(map(len, Dataset(root)))
    assert (found["frames"], found["measured"], found["differing"]) == (frames, frames, 1)
    for name in ("red", "green", "blue"):
        assert found["channels"][name]["largest"] == 1
        assert 0 < found["channels"][name]["mean"] == found["channels"][name]["share"] <= 1 / frames
    assert found["channels"]["depth"] == {"share": 0, "largest": 0, "mean": 0}
    assert found["channels"]["ids"] == {"share": 0}


@pytest.fixture
def tiny(cache: Path) -> Command:
    """The commands with PyBullet's TinyRenderer."""
    return Command(cache, {"MINIVLA_RENDERER": "tiny"})


def test_pixels_of_another_renderer_are_compared_with_a_reference(tiny: Command, recordings: Recordings) -> None:
    states, frames = recordings[Recording.STATES], recordings[Recording.FRAMES]
    words = ("verify", states, "--render", 1, "--reference", frames)
    found = tiny.json(*words, expect=1)["difference"]
    assert (found["frames"], found["differing"], found["measured"]) == (3, 3, 3)
    assert found["recorded_with"] == [Dataset(states)[0].meta.provenance.fingerprint.renderer]
    assert found["rendered_with"][0].startswith("PyBullet TinyRenderer")
    for name in ("red", "green", "blue"):
        assert 0 < found["channels"][name]["mean"] < found["channels"][name]["largest"] <= 255
    assert found["channels"]["depth"]["mean"] < 0.05
    assert 0 < found["channels"]["ids"]["share"] < 0.05
    table = tiny(*words, expect=1).stdout
    assert "3 of 3 rendered frames differ; recorded with " in table
    assert "3 frames compared; colours in levels of 255, depth in metres" in table


def test_without_stored_pixels_the_option_for_a_reference_is_named(tiny: Command, recordings: Recordings) -> None:
    printed = tiny("verify", recordings[Recording.STATES], "--render", 1, expect=1).stdout
    assert "the recorded pixels are not stored; --reference compares with a dataset that stores them" in printed


def test_a_reference_without_frames_is_refused(recordings: Recordings) -> None:
    with pytest.raises(UsageError, match="stores no frames; `factory render` makes a dataset that stores them"):
        verify(recordings[Recording.STATES], render=1, reference=recordings[Recording.STATES])


def test_reference_frames_that_do_not_match_the_recorded_digests_are_found(
    copy: Callable[[Recording], Path], recordings: Recordings
) -> None:
    root = copy(Recording.STATES)
    rewrite(root / EPISODES / "ep_000001.zip", 0)
    report = verify(root, render=1, reference=recordings[Recording.FRAMES])
    found = texts(report, Kind.RENDERED)
    assert any(
        text.startswith("frame 0 of the reference ") and text.endswith(" is not the recorded one") for text in found
    )
    assert report.difference.measured == 0


def test_an_episode_whose_scene_is_missing_is_a_finding(copy: Callable[[Recording], Path]) -> None:
    root = copy(Recording.STATES)
    shutil.rmtree(root / SCENES)
    report = verify(root, render=MAX_EPISODES)
    assert texts(report, Kind.MISSING) == ["is missing"]


def test_rounded_poses_are_refused(tmp_path: Path) -> None:
    make_dataset(tmp_path / "old")
    rows = tmp_path / "old" / "metadata.parquet"
    edit_format(rows, 1)
    with pytest.raises(UsageError, match="ep_000001 has bundle format 1, whose poses are rounded"):
        verify(tmp_path / "old", render=1)


def edit_format(table: Path, number: int) -> None:
    import pyarrow as pa
    import pyarrow.parquet as pq

    rows = pq.read_table(table)
    place = rows.column_names.index("format")
    pq.write_table(rows.set_column(place, "format", pa.array([number] * rows.num_rows, pa.int64())), table)


def test_the_command_prints_how_many_episodes_were_rendered(factory: FactoryCli, recordings: Recordings) -> None:
    found = factory.json("verify", recordings[Recording.STATES], "--render", "all")
    assert found["rendered"] == 2
    assert (found["difference"]["frames"], found["difference"]["differing"]) == (6, 0)
