"""Exports of a states dataset equal those of the frames dataset, byte by byte."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pyarrow.parquet as pq
import pytest

from factory.dataset.reader import Dataset
from factory.export.execution.export_run import ExportOrder, run_export
from factory.export.execution.manifest import MANIFEST_FILE
from factory.export.origin import find_origin
from factory.export.output import WORK_FOLDER
from factory.export.registry import EXPORTERS, find_exporter
from factory.export.rlds import rlds_metadata
from factory.verify.dataset import verify
from schemas.dataset.meta import read_dataset_meta
from schemas.terms import ExpertName, Recording
from tests.builders.driven import make_driven

pytestmark = pytest.mark.gl
Recordings = dict[Recording, Path]
EXPORTS: list[tuple[str, dict[str, Any]]] = [
    ("paper", {"split_names": "published"}),
    ("lerobot", {"depth": True, "ids": True, "fps": 10}),
    ("lerobot-v2.1", {"fps": 6}),
    ("webdataset", {}),
    ("mcap", {"fps": 5}),
    ("mcap", {"ros2": True}),
    ("gnm", {"fps": 6}),
    ("vlnce", {}),
    ("coco", {"fps": 6}),
    ("navdp", {"fps": 6}),
    ("internnav", {}),
]


def exported(root: Path, out: Path, name: str, values: dict[str, Any]) -> dict[str, bytes]:
    options = find_exporter(name).options.model_validate(values)
    assert run_export(ExportOrder(root=root, out=out, format=name, options=options)).complete
    files = {path.relative_to(out): path for path in out.rglob("*") if path.is_file()}
    content = {str(file): path.read_bytes() for file, path in files.items() if file.parts[0] != WORK_FOLDER}
    manifest = json.loads(content[MANIFEST_FILE])
    named = {name: manifest["source"].pop(name) for name in ("run", "record", "dataset_digest")}
    meta = read_dataset_meta(root)
    assert named == {"run": meta.run, "record": meta.plan.record, "dataset_digest": verify(root).digest}
    return {**content, MANIFEST_FILE: json.dumps(manifest).encode()}


def both(recordings: Recordings, out: Path, name: str, values: dict[str, Any]) -> list[dict[str, bytes]]:
    return [exported(recordings[record], out / str(record), name, values) for record in Recording]


def test_every_format_is_compared() -> None:
    assert {name for name, _ in EXPORTS} == EXPORTERS.keys()


def test_the_comparison_without_the_names_of_the_source_still_compares_the_rest(
    recordings: Recordings, tmp_path: Path
) -> None:
    manifest = json.loads(exported(recordings[Recording.STATES], tmp_path / "out", "gnm", {})[MANIFEST_FILE])
    assert {"frames_run", "rows_digest", "selection_digest"} <= manifest["source"].keys()


@pytest.mark.parametrize(("name", "values"), EXPORTS)
def test_an_export_of_states_has_the_bytes_of_an_export_of_frames(
    recordings: Recordings, tmp_path: Path, name: str, values: dict[str, Any]
) -> None:
    frames, states = both(recordings, tmp_path, name, values)
    assert [file for file in sorted(frames.keys() | states.keys()) if frames.get(file) != states.get(file)] == []
    for episode in Dataset(recordings[Recording.STATES]):
        origin = find_origin(tmp_path / Recording.STATES, episode.episode_id)
        assert (origin.episode, origin.states_digest) == (episode.episode_id, episode.states_digest)


def test_the_visibility_that_the_planner_did_not_record_is_computed(tmp_path: Path) -> None:
    planned = {record: tmp_path / str(record) for record in Recording}
    for record, root in planned.items():
        make_driven(root, record, episodes=1, expert=ExpertName.PLANNER)
    assert Dataset(planned[Recording.STATES])[0].summary.steps_visible is None
    frames, states = both(planned, tmp_path / "out", "paper", {})
    assert frames == states
    rows = pq.read_table(tmp_path / "out/states/metadata.parquet")
    expected = Dataset(planned[Recording.FRAMES]).metadata
    for column in ("steps_visible", "content_digest", "run", "plan_digest"):
        assert rows[column].to_pylist() == expected[column].to_pylist()


def test_meta_json_of_an_export_names_the_instances(recordings: Recordings, tmp_path: Path) -> None:
    files = exported(recordings[Recording.STATES], tmp_path / "out", "paper", {})
    meta = json.loads(files["episodes/ep_000001/meta.json"])
    assert meta["target_instance_id"] in [instance["id"] for instance in meta["instances"]]


def test_rlds_metadata_of_both_recordings_are_equal(recordings: Recordings) -> None:
    frames, states = (Dataset(recordings[record]) for record in Recording)
    assert [rlds_metadata(episode) for episode in frames] == [rlds_metadata(episode) for episode in states]
    assert frames[0].states_digest != frames[1].states_digest


def test_an_export_that_was_started_from_frames_is_continued_from_states(
    recordings: Recordings, tmp_path: Path
) -> None:
    for record in Recording:
        order = ExportOrder(recordings[record], tmp_path / "out", "gnm", find_exporter("gnm").options())
        report = run_export(order)
        assert (report.complete, report.resumed) == (True, 0 if record is Recording.FRAMES else 2)
