"""Exports of a states dataset equal those of the frames dataset, byte by byte."""

from __future__ import annotations

import json
import shlex
import shutil
from pathlib import Path
from typing import Any

import pyarrow.parquet as pq
import pytest

from factory.dataset.reader import Dataset
from factory.export.execution.export_run import ExportOrder, run_export
from factory.export.execution.manifest import MANIFEST_FILE
from factory.export.execution.report_text import print_render_hint
from factory.export.origin import find_origin
from factory.export.output import WORK_FOLDER
from factory.export.registry import EXPORTERS, find_exporter
from factory.export.rlds import rlds_metadata
from factory.verify.dataset import verify
from schemas.dataset.meta import read_dataset_meta
from schemas.terms import ExpertName, Recording
from tests.acceptance.factory_cli import FactoryCli
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
    ("rlds", {"fps": 6}),
    ("robomimic", {"fps": 6, "image_px": 96}),
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


def test_the_hint_after_a_long_export_of_states_stores_frames_that_export_to_the_same_bytes(
    factory: FactoryCli, recordings: Recordings, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    states = tmp_path / "my drives"
    shutil.copytree(recordings[Recording.STATES], states)
    options = find_exporter("gnm").options.model_validate({"fps": 3})
    report = run_export(ExportOrder(root=states, out=tmp_path / "one", format="gnm", options=options))
    print_render_hint(report.model_copy(update={"seconds": 9.0}))
    assert capsys.readouterr().err == ""
    print_render_hint(report.model_copy(update={"seconds": 30.0}))
    words = shlex.split(capsys.readouterr().err.rpartition(": ")[2])
    assert words[:2] == ["factory", "render"]
    assert factory(*words[1:]).returncode == 0
    frames = Path(words[-1])
    assert read_dataset_meta(frames).plan.record is Recording.FRAMES
    again = run_export(ExportOrder(root=frames, out=tmp_path / "two", format="gnm", options=options))
    assert again.render_command is None
    files = [path.relative_to(tmp_path / "one") for path in (tmp_path / "one").rglob("*") if path.is_file()]
    one, two = ({f: (tmp_path / name / f).read_bytes() for f in files} for name in ("one", "two"))
    assert [f for f in files if f.name != MANIFEST_FILE and one[f] != two[f]] == []


def test_there_is_no_hint_for_formats_without_frames_and_none_in_the_second_call(
    recordings: Recordings, tmp_path: Path
) -> None:
    states = recordings[Recording.STATES]
    without_frames = ExportOrder(states, tmp_path / "a", "vlnce", find_exporter("vlnce").options())
    assert run_export(without_frames).render_command is None
    order = ExportOrder(states, tmp_path / "b", "gnm", find_exporter("gnm").options.model_validate({"fps": 1}))
    assert run_export(order).render_command is not None
    assert run_export(order).render_command is None
