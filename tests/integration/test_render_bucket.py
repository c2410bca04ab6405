"""`factory render` with both datasets in object storage."""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

from factory.dataset.reader import Dataset
from factory.verify.dataset import verify
from schemas.storage.object_path import ObjectPath
from schemas.terms import Recording

pytestmark = pytest.mark.gl


def upload(root: Path, place: ObjectPath) -> None:
    for path in root.rglob("*"):
        if path.is_file():
            place.objects.put((place / str(path.relative_to(root))).key, path.read_bytes())


def test_states_in_a_bucket_are_rendered_into_a_bucket(
    recordings: dict[Recording, Path], bucket_url: Callable[[], str]
) -> None:
    bucket = bucket_url()
    states, out = ObjectPath.at(f"{bucket}/states"), ObjectPath.at(f"{bucket}/frames")
    upload(recordings[Recording.STATES], states)
    command = [sys.executable, "-m", "factory", "render", str(states), "-o", str(out), "--json"]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    wanted = Dataset(recordings[Recording.FRAMES])
    summary = json.loads(done.stdout)
    assert (summary["dataset"], summary["digest"]) == (str(out), wanted.digest)
    report = verify(out, deep=True)
    assert (report.ok, report.complete, report.digest) == (True, True, wanted.digest)
    again = subprocess.run(command, capture_output=True, text=True, check=True)
    assert json.loads(again.stdout)["attempts"] == summary["attempts"]
