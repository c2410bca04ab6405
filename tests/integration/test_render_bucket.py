"""`factory render` with the states dataset and the rendered dataset in object storage."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

from factory.dataset.reader import Dataset
from factory.verify.dataset import verify
from schemas.storage.object_path import ObjectPath
from schemas.terms import Recording
from tests.acceptance.factory_cli import FactoryCli
from tests.builders.object_server import ObjectServer

pytestmark = pytest.mark.gl


def upload(root: Path, place: ObjectPath) -> None:
    for path in root.rglob("*"):
        if path.is_file():
            place.objects.put((place / str(path.relative_to(root))).key, path.read_bytes())


@pytest.mark.slow
def test_states_in_a_bucket_are_rendered_into_a_bucket(
    object_store: ObjectServer,
    cache: Path,
    recordings: dict[Recording, Path],
    bucket_url: Callable[[], str],
    tmp_path: Path,
) -> None:
    factory = FactoryCli(tmp_path, cache, {**object_store.variables(), "MINIVLA_STATE": str(tmp_path / "state")})
    bucket = bucket_url()
    states, out = ObjectPath.at(f"{bucket}/states"), ObjectPath.at(f"{bucket}/frames")
    upload(recordings[Recording.STATES], states)
    summary = factory.json("render", states, "-o", out)
    wanted = Dataset(recordings[Recording.FRAMES])
    assert (summary["dataset"], summary["digest"]) == (str(out), wanted.digest)
    report = verify(out, deep=True)
    assert (report.ok, report.complete, report.digest) == (True, True, wanted.digest)
    assert factory.json("render", states, "-o", out)["attempts"] == summary["attempts"]
