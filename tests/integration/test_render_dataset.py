"""`factory render`: turns a states dataset into the frames dataset that a run would have made."""

from __future__ import annotations

import base64
import io
import json
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from coordinator.validation.validate import validate
from factory.dataset.reader import Dataset
from factory.dataset.site import site_of
from factory.runs.render import StatesSource, prepare_rendering
from factory.verify.dataset import verify
from schemas.bundle import BundleReader, BundleWriter
from schemas.dataset_files import EPISODES
from schemas.errors import UsageError, WorldError
from schemas.job import Job
from schemas.terms import Recording
from tests.builders.driven import make_driven
from workers.sim.render_recording import render_recording
from workers.sim.scene_renderer import SceneRenderer

pytestmark = pytest.mark.gl
Recordings = dict[Recording, Path]


def factory(*arguments: object) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-m", "factory", *map(str, arguments)]
    return subprocess.run(command, capture_output=True, text=True, check=False)


def frames_job(episode: BundleReader) -> Job:
    return episode.meta.job.model_copy(update={"record": Recording.FRAMES, "plan_digest": "f" * 64, "run": "frames"})


@pytest.fixture
def stage(recordings: Recordings) -> SceneRenderer:
    dataset = Dataset(recordings[Recording.STATES])
    ((name, sha256),) = dataset.meta.scenes.items()
    opened = SceneRenderer("gl", apart=True)
    opened.load(next(Path(str(dataset.root)).glob(f"scenes/{name}-*.zip")), sha256)
    return opened


def test_the_rendered_dataset_has_the_digest_of_the_frames_recording(recordings: Recordings, tmp_path: Path) -> None:
    out = tmp_path / "frames"
    done = factory("render", recordings[Recording.STATES], "-o", out, "--workers", 1, "--renderer", "gl", "--json")
    assert done.returncode == 0, done.stderr
    wanted = Dataset(recordings[Recording.FRAMES])
    assert json.loads(done.stdout)["digest"] == wanted.digest
    report = verify(out, deep=True)
    assert (report.ok, report.complete, report.digest) == (True, True, wanted.digest)
    for one, other in zip(Dataset(out), wanted, strict=True):
        ours, theirs = (episode.meta.model_dump(exclude={"provenance"}) for episode in (one, other))
        assert ours == theirs
    recorded = Dataset(recordings[Recording.STATES])
    assert [episode.meta.provenance for episode in Dataset(out)] == [episode.meta.provenance for episode in recorded]


def test_an_interrupted_rendering_continues_and_makes_no_episode_twice(recordings: Recordings, tmp_path: Path) -> None:
    out = tmp_path / "frames"
    rendering = prepare_rendering(recordings[Recording.STATES], site_of(str(out)))
    first = "episodes/ep_000001.zip"
    (out / EPISODES).mkdir()
    shutil.copy(recordings[Recording.FRAMES] / first, out / first)
    before = (out / first).stat().st_mtime_ns
    done = factory("render", recordings[Recording.STATES], "-o", out, "--workers", 1, "--renderer", "gl", "--json")
    assert done.returncode == 0, done.stderr
    assert (out / first).stat().st_mtime_ns == before
    assert Dataset(out).digest == Dataset(recordings[Recording.FRAMES]).digest
    assert rendering.plan.record is Recording.FRAMES


def test_a_frames_dataset_and_another_run_are_refused(recordings: Recordings, tmp_path: Path) -> None:
    with pytest.raises(UsageError, match="stores frames already"):
        prepare_rendering(recordings[Recording.FRAMES], site_of(str(tmp_path / "out")))
    other = tmp_path / "other"
    make_driven(other, Recording.FRAMES, episodes=1)
    with pytest.raises(UsageError, match="not the requested driven-"):
        prepare_rendering(recordings[Recording.STATES], site_of(str(other)))


def test_damaged_states_are_not_used(recordings: Recordings, tmp_path: Path) -> None:
    root = Path(shutil.copytree(recordings[Recording.STATES], tmp_path / "states"))
    dataset = Dataset(root)
    source, job = StatesSource(dataset), dataset[0].meta.job
    assert base64.b64decode(source(job) or "") == (root / "episodes/ep_000001.zip").read_bytes()
    assert source(job.model_copy(update={"attempt": job.attempt + 1})) is None
    (root / "episodes/ep_000001.zip").write_bytes(b"PK")
    assert source(job) is None
    (root / "episodes/ep_000001.zip").unlink()
    assert source(job) is None


def test_a_rendered_bundle_equals_the_recorded_one(recordings: Recordings, stage: SceneRenderer) -> None:
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


def test_states_of_another_job_are_refused(recordings: Recordings, stage: SceneRenderer) -> None:
    states = (recordings[Recording.STATES] / "episodes/ep_000001.zip").read_bytes()
    job = frames_job(BundleReader(io.BytesIO(states))).model_copy(update={"attempt": 99})
    with stage, pytest.raises(WorldError, match="ep_000001: the states are of another job"):
        render_recording(job, stage, states, io.BytesIO(), lambda _step: None)


def test_a_renderer_that_gives_other_frames_is_refused(recordings: Recordings, stage: SceneRenderer) -> None:
    recorded = BundleReader(io.BytesIO((recordings[Recording.STATES] / "episodes/ep_000001.zip").read_bytes()))
    file = io.BytesIO()
    writer = BundleWriter(file)
    for _ in recorded.meta.frame_digests:  # the digests of another renderer
        writer.add_digest(np.zeros((4, 4, 3), np.uint8), np.zeros((4, 4), np.float32), np.zeros((4, 4), np.uint16))
    writer.finish(recorded.arrays, recorded.meta)
    with stage, pytest.raises(WorldError, match="frame 0 differs from the recorded digest; recorded with"):
        render_recording(frames_job(recorded), stage, file.getvalue(), io.BytesIO(), lambda _step: None)
