"""Exports of a relabelled dataset of states at a low rate: every question is asked at a true frame, or is listed."""

from __future__ import annotations

import json
import tarfile
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow.parquet as pq
import pytest
from PIL import Image

from factory.dataset.reader import Dataset
from factory.export.execution.export_run import ExportOrder, run_export
from factory.export.execution.manifest import ExportReport
from factory.export.execution.report_text import print_omitted, print_report
from factory.export.lerobot.subtasks import EVENTS
from factory.export.questions import QUESTIONS_FILE
from factory.export.registry import find_exporter
from factory.relabel.relabel_dataset import relabel
from schemas.language.compose import composer_of
from schemas.language.language_file import LanguageSpec
from schemas.language.question.verify import QuestionVerifier
from schemas.language.route.steps import SceneRoutes
from schemas.terms import Recording

pytestmark = pytest.mark.gl
SPEC = LanguageSpec(questions=True, seed=3)
FPS = 2


@pytest.fixture(scope="module")
def asked(recordings: dict[Recording, Path], tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The two drives of states with questions."""
    out = tmp_path_factory.mktemp("asked") / "asked"
    relabel(recordings[Recording.STATES], out, SPEC)
    return out


def export(root: Path, out: Path, name: str, **values: Any) -> ExportReport:
    options = find_exporter(name).options.model_validate(values)
    report = run_export(ExportOrder(root=root, out=out, format=name, options=options))
    assert report.complete
    return report


def lines_of(out: Path) -> list[dict[str, Any]]:
    return [json.loads(line) for line in (out / QUESTIONS_FILE).read_text().splitlines()]


def test_moved_questions_have_the_picture_of_a_frame_at_which_the_verifier_accepts_them(
    asked: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    dataset = Dataset(asked)
    questions = {f"{each.episode_id}/{n}": (each, q) for each in dataset for n, q in enumerate(each.questions, 1)}
    report = export(asked, tmp_path / "out", "gnm", fps=FPS)
    count, lines = report.questions, lines_of(tmp_path / "out")
    assert count is not None
    assert sorted([*(line["id"] for line in lines), *(each.id for each in count.omitted)]) == sorted(questions)
    assert count.asked == len(lines)
    moved = [line for line in lines if line["step"] != line["computed_at"]]
    assert 0 < len(moved) == count.moved
    for line in moved:
        episode, question = questions[line["id"]]
        job = episode.meta.job
        scene = episode.package.language()
        verifier = QuestionVerifier(SceneRoutes(scene, job.camera), episode.poses, scene.graph.number_of[job.target_id])
        end = line["step"] + 1 if question.end == question.start + 1 else question.end
        there = question.model_copy(update={"start": line["step"], "end": end})
        assert verifier.check(there, composer_of(SPEC).reader(question.language), episode) == ""
        assert question.start == line["computed_at"]
    for line in lines:
        with Image.open(tmp_path / "out" / line["image"]) as image:
            seen = np.asarray(image, np.int16)
        episode, _ = questions[line["id"]]
        assert np.abs(seen - episode.rgb(line["step"])).mean() < 4
    assert json.loads((tmp_path / "out/export.json").read_text())["questions"]["moved"] == count.moved
    print_omitted(report)
    print_report(report)
    said = capsys.readouterr()
    assert f"{count.asked} questions, {count.moved} of them moved" in said.out
    assert said.err.count(" is not in the export") == len(count.omitted)
    assert f"{count.asked} questions, {count.moved} of them moved" in (tmp_path / "out/README.md").read_text()


def test_formats_with_pictures_list_them_and_lerobot_has_the_same_questions_in_its_column(
    asked: Path, tmp_path: Path
) -> None:
    first = export(asked, tmp_path / "gnm", "gnm", fps=FPS).questions
    for name in ("navdp", "webdataset", "lerobot"):
        assert export(asked, tmp_path / name, name, fps=FPS).questions == first, name
    keyframes = export(asked, tmp_path / "internnav", "internnav").questions
    whole = export(asked, tmp_path / "paper", "paper").questions
    assert whole is not None
    assert (whole.moved, whole.omitted) == (0, ())
    assert keyframes is not None
    assert keyframes.asked + len(keyframes.omitted) == whole.asked
    for name in ("navdp", "internnav", "paper"):
        assert all((tmp_path / name / line["image"]).is_file() for line in lines_of(tmp_path / name)), name
    members = set()
    for shard in (tmp_path / "webdataset").glob("*.tar"):
        with tarfile.open(shard) as archive:
            members |= set(archive.getnames())
    lines = lines_of(tmp_path / "webdataset")
    assert {line["image"] for line in lines} <= members
    (rows,) = (pq.read_table(path) for path in (tmp_path / "lerobot/data").rglob("*.parquet"))
    seen = [(row["frame_index"], each["content"]) for row in rows.to_pylist() for each in row[EVENTS]]
    assert sorted(seen) == sorted((line["frame"], line[key]) for line in lines for key in ("question", "answer"))


def test_the_images_of_a_rig_have_no_questions_and_the_export_says_so(asked: Path, tmp_path: Path) -> None:
    options = find_exporter("webdataset").options.model_validate({"fps": FPS})
    order = ExportOrder(asked, tmp_path / "out", "webdataset", options, episodes=("ep_000001",), rig="turtlebot4")
    count = run_export(order).questions
    assert count is not None
    assert (count.asked, len(count.omitted)) == (0, len(Dataset(asked)["ep_000001"].questions))
    assert "recorded camera" in count.omitted[0].reason
    assert not (tmp_path / "out" / QUESTIONS_FILE).exists()
