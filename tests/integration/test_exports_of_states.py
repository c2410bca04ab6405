"""Exports of a states dataset: the images and arrays of an export of a frames dataset, byte by byte."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from factory.export.execution.run import ExportOrder, run_export
from factory.export.output import WORK_FOLDER
from factory.export.registry import find_exporter
from schemas.terms import Recording

pytestmark = pytest.mark.gl


def exported(root: Path, out: Path, name: str) -> dict[str, bytes]:
    options = find_exporter(name).options()
    assert run_export(ExportOrder(root=root, out=out, format=name, options=options)).complete
    files = {path.relative_to(out): path for path in out.rglob("*") if path.is_file()}
    return {str(file): path.read_bytes() for file, path in files.items() if file.parts[0] != WORK_FOLDER}


TITLES = {"README.md", "export.json"}
"""Files that name the run and the digest of the dataset."""
DIFFERING = {
    "webdataset": TITLES,
    "gnm": TITLES,
    "lerobot": {*TITLES, "meta/episodes/chunk-000/file-000.parquet"},  # it has the content digests
    "paper": {
        *(*TITLES, "dataset_meta.json", "metadata.parquet", "data/train_id.parquet"),
        *(f"episodes/ep_00000{number}/meta.json" for number in (1, 2)),
    },
}


@pytest.mark.parametrize("name", DIFFERING)
def test_an_export_has_the_same_images_and_arrays(recordings: dict[Recording, Path], tmp_path: Path, name: str) -> None:
    frames, states = (exported(recordings[record], tmp_path / str(record), name) for record in Recording)
    assert frames.keys() == states.keys()
    assert {file for file, data in frames.items() if states[file] != data} == DIFFERING[name]


def test_meta_json_of_an_export_names_the_instances(recordings: dict[Recording, Path], tmp_path: Path) -> None:
    meta = json.loads(exported(recordings[Recording.STATES], tmp_path / "out", "paper")["episodes/ep_000001/meta.json"])
    assert meta["target_instance_id"] in [instance["id"] for instance in meta["instances"]]
