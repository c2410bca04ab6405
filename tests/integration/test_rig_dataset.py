"""Datasets that store the measurements of a rig: `factory render --rig`, reading, validation and compatibility."""

from __future__ import annotations

import io
import json
import shutil
import zipfile
from pathlib import Path

import numpy as np
import pytest

from factory.cli.main import cli
from factory.dataset.bundle import EpisodeBundle
from factory.dataset.reader import Dataset
from factory.dataset.site import site_of
from factory.runs.render import prepare_rendering
from factory.runs.replay import replay_episode
from factory.verify.dataset import verify
from factory.verify.rendering import RenderDifference, compare_rendered
from schemas.dataset.meta import FORMAT_WITH_RIG, described_by
from schemas.encoding.container import ContainerWriter
from schemas.episode import BUNDLE_WITH_RIG
from schemas.errors import InvalidRig, UsageError
from schemas.rig.rig_file import load_rig
from schemas.storage.dataset_files import META_FILE
from schemas.terms import Recording
from tests.builders.rigs import write_rig
from workers.sensors.observation import arrays_in

pytestmark = pytest.mark.gl
Recordings = dict[Recording, Path]


def test_stored_sensors_equal_those_rendered_on_read(rigged: Path, recordings: Recordings, tmp_path: Path) -> None:
    stored, rendered = Dataset(rigged)[0], Dataset(recordings[Recording.STATES], rig=write_rig(tmp_path))[0]
    assert stored.rig is not None
    assert len(stored) == len(rendered)
    last = (len(stored) - 1) // 3 * 3
    for t in (0, 3, 4, 6, last):
        ours, theirs = stored.observe(t), rendered.observe(t)
        assert list(ours) == list(theirs)
        for name, seen in ours.items():
            expected = arrays_in(theirs[name])
            assert {key: array.tobytes() for key, array in arrays_in(seen).items()} == {
                key: array.tobytes() for key, array in expected.items()
            }
    assert stored.observe(last)["front"].flow is None
    for name, moved in stored.motion().items():
        for key, array in arrays_in(moved).items():
            assert np.array_equal(array, arrays_in(rendered.motion()[name])[key])


def test_stored_sensors_are_read_without_the_scene(rigged: Path, tmp_path: Path) -> None:
    copied = Path(shutil.copytree(rigged, tmp_path / "copied"))
    shutil.rmtree(copied / "scenes")
    episode = Dataset(copied)[0]
    assert set(episode.observe(0)) == {"front", "scan"}
    assert set(episode.motion()) == {"imu", "wheels"}


def test_a_dataset_with_a_rig_is_valid_and_has_the_frames_and_states_of_the_other_recordings(
    rigged: Path, recordings: Recordings
) -> None:
    report = verify(rigged, deep=True)
    assert (report.ok, report.complete) == (True, True)
    for ours, frames, states in zip(
        Dataset(rigged), *(Dataset(recordings[kind]) for kind in (Recording.FRAMES, Recording.STATES)), strict=True
    ):
        assert ours.meta.frame_digests == frames.meta.frame_digests
        assert ours.states_digest == frames.states_digest == states.states_digest
        assert ours.summary.content_digest != frames.summary.content_digest


def test_a_repeated_simulation_of_the_job_gives_identical_measurements(rigged: Path) -> None:
    episode = Dataset(rigged)[0]
    assert replay_episode(rigged, episode.path, "gl", lambda _step, _steps: None).is_identical


def test_rendering_again_finds_measurements_of_a_wrong_step(rigged: Path) -> None:
    episode = Dataset(rigged)[0]
    with episode.path.open("rb") as file:
        assert compare_rendered(EpisodeBundle(file, rigged), RenderDifference()) == []
    moved = io.BytesIO()
    with zipfile.ZipFile(episode.path) as found, ContainerWriter(moved) as out:
        for name in found.namelist():
            out.add(name, found.read(name.replace("ranges/000000", "ranges/000006")))
    findings = compare_rendered(EpisodeBundle(moved, rigged), RenderDifference())
    assert findings == ["sensor scan differs at step 0 when it is measured again"]


def test_rig_and_its_digest_are_described(rigged: Path) -> None:
    dataset = Dataset(rigged)
    rig = dataset.meta.plan.rig
    assert rig is not None
    assert (dataset.meta.format, dataset.meta.rig_digest) == (FORMAT_WITH_RIG, rig.digest)
    meta = dataset[0].meta
    assert (meta.format, meta.job.view.rig, list(meta.sensor_digests)) == (
        BUNDLE_WITH_RIG,
        rig,
        [sensor.name for sensor in rig.sensors],
    )
    assert f"rig `{rig.name}`" in (rigged / "README.md").read_text()


def test_the_rig_of_a_states_plan_is_the_default_of_its_readers_and_renderings(
    recordings: Recordings, tmp_path: Path
) -> None:
    copied = Path(shutil.copytree(recordings[Recording.STATES], tmp_path / "states"))
    meta, rig = Dataset(copied).meta, load_rig(str(write_rig(tmp_path)))
    described = described_by(meta, meta.plan.model_copy(update={"rig": rig}))
    (copied / META_FILE).write_text(described.model_dump_json())
    assert set(Dataset(copied)[0].motion()) == {"imu", "wheels"}
    assert prepare_rendering(copied, site_of(str(tmp_path / "out"))).plan.rig == rig
    plain = prepare_rendering(copied, site_of(str(tmp_path / "plain")), rig="paper").plan
    assert plain.digest == Dataset(recordings[Recording.FRAMES]).meta.plan.digest


def test_a_rig_that_does_not_fit_the_plan_is_refused(recordings: Recordings, tmp_path: Path) -> None:
    path = tmp_path / "slow.toml"
    path.write_text(write_rig(tmp_path).read_text().replace("rate_hz = 10", "rate_hz = 17"))
    with pytest.raises(InvalidRig, match="rate_hz 17 does not divide the control rate, 30 Hz"):
        prepare_rendering(recordings[Recording.STATES], site_of(str(tmp_path / "out")), rig=str(path))


def test_a_dataset_is_not_continued_with_another_rig(rigged: Path, recordings: Recordings) -> None:
    with pytest.raises(UsageError, match=r"but driven-\S+ .* was requested"):
        prepare_rendering(recordings[Recording.STATES], site_of(str(rigged)), rig="panorama")


def test_older_software_refuses_a_dataset_with_a_rig_by_its_format(rigged: Path) -> None:
    # versions of the software without rigs refuse a dataset if this number is not 1
    assert json.loads((rigged / META_FILE).read_text())["format"] == 2


def test_two_rigs_of_one_name_are_refused(recordings: Recordings, tmp_path: Path) -> None:
    states, rig = str(recordings[Recording.STATES]), str(write_rig(tmp_path))
    with pytest.raises(UsageError, match="two rigs are named 'small'"):
        cli.main(["render", states, "--rig", rig, "--rig", rig, "-o", str(tmp_path / "out")], standalone_mode=False)
