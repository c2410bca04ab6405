"""`factory render`: turns a states dataset into the frames dataset that a run would have made."""

from __future__ import annotations

import base64
import io
import shutil
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from coordinator.validation.validate import validate
from factory.dataset.reader import Dataset
from factory.dataset.site import site_of
from factory.runs.render import StatesSource, prepare_rendering
from factory.verify.dataset import verify
from schemas.bundle import BundleReader, BundleWriter
from schemas.episode import BUNDLE_FORMAT
from schemas.errors import UsageError, WorldError
from schemas.job import Job
from schemas.storage.dataset_files import EPISODES, METADATA_FILE, SCENES
from schemas.storage.place import digest_of
from schemas.terms import Recording
from tests.acceptance.factory_cli import Command, FactoryCli
from tests.builders.dataset import make_dataset
from workers.sim.context import SimulationContext
from workers.sim.render_recording import render_recording

pytestmark = pytest.mark.gl
Recordings = dict[Recording, Path]


def frames_job(episode: BundleReader) -> Job:
    return episode.meta.job.model_copy(update={"record": Recording.FRAMES, "plan_digest": "f" * 64, "run": "frames"})


@pytest.fixture
def stage(recordings: Recordings) -> SimulationContext:
    dataset = Dataset(recordings[Recording.STATES])
    ((name, sha256),) = dataset.meta.scenes.items()
    opened = SimulationContext("gl", apart=True)
    opened.load(next(Path(str(dataset.root)).glob(f"scenes/{name}-*.zip")), sha256)
    return opened


def test_the_rendered_dataset_has_the_digest_of_the_frames_recording(
    factory: FactoryCli, recordings: Recordings, tmp_path: Path
) -> None:
    out = tmp_path / "frames"
    done = factory.json("render", recordings[Recording.STATES], "-o", out, "--workers", 1, "--renderer", "gl")
    wanted = Dataset(recordings[Recording.FRAMES])
    assert done["digest"] == wanted.digest
    report = verify(out, deep=True)
    assert (report.ok, report.complete, report.digest) == (True, True, wanted.digest)
    for one, other in zip(Dataset(out), wanted, strict=True):
        ours, theirs = (episode.meta.model_dump(exclude={"provenance"}) for episode in (one, other))
        assert ours == theirs
    recorded = Dataset(recordings[Recording.STATES])
    assert [episode.meta.provenance for episode in Dataset(out)] == [episode.meta.provenance for episode in recorded]


@pytest.mark.slow
def test_an_interrupted_rendering_continues_and_makes_no_episode_twice(
    factory: FactoryCli, recordings: Recordings, tmp_path: Path
) -> None:
    out = tmp_path / "frames"
    rendering = prepare_rendering(recordings[Recording.STATES], site_of(str(out)))
    first = "episodes/ep_000001.zip"
    (out / EPISODES).mkdir(exist_ok=True)
    shutil.copy(recordings[Recording.FRAMES] / first, out / first)
    before = (out / first).stat().st_mtime_ns
    factory("render", recordings[Recording.STATES], "-o", out, "--workers", 1, "--renderer", "gl")
    assert (out / first).stat().st_mtime_ns == before
    assert Dataset(out).digest == Dataset(recordings[Recording.FRAMES]).digest
    assert rendering.plan.record is Recording.FRAMES


def test_a_frames_dataset_and_another_run_are_refused(recordings: Recordings, tmp_path: Path) -> None:
    with pytest.raises(UsageError, match="stores frames already"):
        prepare_rendering(recordings[Recording.FRAMES], site_of(str(tmp_path / "out")))
    other = tmp_path / "other"
    make_dataset(other)
    with pytest.raises(UsageError, match=r"but driven-\S+ .* was requested"):
        prepare_rendering(recordings[Recording.STATES], site_of(str(other)))


@pytest.fixture
def copied(recordings: Recordings, tmp_path: Path) -> Path:
    return Path(shutil.copytree(recordings[Recording.STATES], tmp_path / "states"))


def edit_metadata(root: Path, column: str, value: int) -> None:
    rows = pq.read_table(root / METADATA_FILE)
    place = rows.column_names.index(column)
    pq.write_table(rows.set_column(place, column, pa.array([value] * rows.num_rows, pa.int64())), root / METADATA_FILE)


def refusal(command: Command, states: Path, out: Path, *words: str) -> str:
    done = command("render", states, "-o", out, *words, expect=1)
    assert not out.exists()
    return done.stderr


def test_a_renderer_that_gives_other_frames_is_refused_before_the_start(
    command: Command, copied: Path, tmp_path: Path
) -> None:
    recorded = Dataset(copied)[0].summary.renderer
    error = refusal(command, copied, tmp_path / "out", "--renderer", "tiny")
    assert f"ep_000001: frame 0 differs from the recorded digest; recorded with {recorded}, rendered with" in error
    assert "TinyRenderer" in error


def test_an_edited_and_a_missing_scene_are_refused_before_the_start(
    command: Command, copied: Path, tmp_path: Path
) -> None:
    package = next((copied / SCENES).glob("*.scene.zip"))
    package.write_bytes(package.read_bytes() + b"x")
    error = refusal(command, copied, tmp_path / "out")
    assert f"SHA-256 {Dataset(copied)[0].summary.scene_sha256} is missing: {package} has SHA-256 " in error
    assert f"{digest_of(package)}; searched: {copied / SCENES}" in error
    package.unlink()
    assert "no package of scene box_room was found; searched:" in refusal(command, copied, tmp_path / "out")


def test_episodes_of_a_newer_format_are_refused(command: Command, copied: Path, tmp_path: Path) -> None:
    edit_metadata(copied, "format", BUNDLE_FORMAT + 1)
    expected = f"has episodes of bundle format {BUNDLE_FORMAT + 1}, this software reads up to {BUNDLE_FORMAT}: upgrade"
    assert expected in refusal(command, copied, tmp_path / "out")


def test_frames_that_do_not_fit_on_the_disk_are_refused(copied: Path, tmp_path: Path) -> None:
    edit_metadata(copied, "num_steps", 10**12)
    with pytest.raises(WorldError, match=r"2000000000000 frames need at least 300000000.00 GB, and .* GB free: free"):
        prepare_rendering(copied, site_of(str(tmp_path / "out")))
    assert not (tmp_path / "out").exists()


def test_a_directory_inside_a_dataset_is_refused(copied: Path) -> None:
    with pytest.raises(UsageError, match="is inside the dataset"):
        prepare_rendering(copied, site_of(str(copied / "frames")))


def test_damaged_states_are_not_used(copied: Path) -> None:
    dataset = Dataset(root := copied)
    source, job = StatesSource(dataset), dataset[0].meta.job
    assert base64.b64decode(source(job) or "") == (root / "episodes/ep_000001.zip").read_bytes()
    assert source(job.model_copy(update={"attempt": job.attempt + 1})) is None
    (root / "episodes/ep_000001.zip").write_bytes(b"PK")
    assert source(job) is None
    (root / "episodes/ep_000001.zip").unlink()
    assert source(job) is None


def test_a_rendered_bundle_equals_the_recorded_one(recordings: Recordings, stage: SimulationContext) -> None:
    states, out = (recordings[Recording.STATES] / "episodes/ep_000002.zip").read_bytes(), io.BytesIO()
    steps: list[int] = []
    with stage:
        job = frames_job(BundleReader(io.BytesIO(states)))
        render_recording(job, stage, states, out, steps.append)
    bundle = BundleReader(out)
    assert steps == list(range(1, bundle.length + 1))
    assert validate(bundle, job) == []
    wanted = Dataset(recordings[Recording.FRAMES])["ep_000002"].meta
    assert bundle.meta.frame_digests == wanted.frame_digests
    assert bundle.meta.rollout == wanted.rollout


def test_states_of_another_job_are_refused(recordings: Recordings, stage: SimulationContext) -> None:
    states = (recordings[Recording.STATES] / "episodes/ep_000001.zip").read_bytes()
    job = frames_job(BundleReader(io.BytesIO(states))).model_copy(update={"attempt": 99})
    with stage, pytest.raises(WorldError, match="ep_000001: the states are of another job"):
        render_recording(job, stage, states, io.BytesIO(), lambda _step: None)


def test_a_renderer_that_gives_other_frames_is_refused(recordings: Recordings, stage: SimulationContext) -> None:
    recorded = BundleReader(io.BytesIO((recordings[Recording.STATES] / "episodes/ep_000001.zip").read_bytes()))
    file = io.BytesIO()
    writer = BundleWriter(file)
    for _ in recorded.meta.frame_digests:  # digests of frames that no renderer gives
        writer.add_digest(np.zeros((4, 4, 3), np.uint8), np.zeros((4, 4), np.float32), np.zeros((4, 4), np.uint16))
    writer.finish(recorded.arrays, recorded.meta)
    with stage, pytest.raises(WorldError, match="frame 0 differs from the recorded digest; recorded with"):
        render_recording(frames_job(recorded), stage, file.getvalue(), io.BytesIO(), lambda _step: None)
