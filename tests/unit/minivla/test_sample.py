"""The sample of the package: it is small, valid, and opens from any folder."""

from __future__ import annotations

from pathlib import Path

import pytest

import minivla
from factory.verify.dataset import verify

FOLDER = Path(minivla.__file__).with_name("sample_data")


def test_the_sample_has_two_episodes_of_two_scenes_with_verified_instructions() -> None:
    sample = minivla.sample()
    assert sorted(episode.meta.job.scene for episode in sample) == ["hospital", "hospital", "office", "office"]
    assert sample[0].instruction == "If you could, drive to the monitor nearest to the printer."
    assert sample.meta.plan.record == "states"


def test_the_sample_takes_at_most_300_kb_beside_its_scenes() -> None:
    files = [path for path in FOLDER.rglob("*") if path.is_file() and "scenes" not in path.parts]
    assert sum(path.stat().st_size for path in files) <= 300_000


def test_the_sample_is_valid() -> None:
    assert not verify(FOLDER, deep=True).findings


@pytest.mark.gl
def test_frames_of_the_sample_equal_the_recorded_digests(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from schemas.encoding.digest import frame_digest

    monkeypatch.chdir(tmp_path)
    for episode in minivla.sample():
        assert frame_digest(*episode.frame(0)) == episode.meta.frame_digests[0]
