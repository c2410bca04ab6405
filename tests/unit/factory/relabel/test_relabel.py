"""Tests `factory relabel` on a small dataset: verified instructions, continuation, and refusals that change nothing."""

import dataclasses
import json
import threading
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest

from factory.cli.relabel import command
from factory.dataset.reader import Dataset
from factory.relabel.part import LanguageStart, rows_of
from factory.relabel.relabel_dataset import relabel
from factory.verify.dataset import verify
from schemas.config import CameraConfig
from schemas.errors import InvalidLanguage, UsageError
from schemas.language.expression import Family
from schemas.language.graph.scene_graph import build_graph
from schemas.language.graph.view import look
from schemas.language.language_file import LanguageSpec
from schemas.language.question.meaning import Question
from schemas.language.question.verify import QuestionVerifier
from schemas.language.route.steps import SceneRoutes
from schemas.language.scene import SceneLanguage
from schemas.language.sentence.reading import reader
from schemas.scene import Instance, encode_scene
from schemas.terms import Split
from tests.builders.dataset import chair, make_dataset
from tests.builders.language import furnished_scene

SPEC = LanguageSpec(per_episode=2, false_premises=1.0, languages={"en": 1, "de": 1, "es": 1, "zh": 1}, questions=True)
SPLITS = (Split.TRAIN_ID, Split.TEST_PARAPHRASE_OOD)


def scene_with_the_chair():
    """Returns the furnished scene, named office, with the red chair of the small bundles added to it."""
    scene, target = furnished_scene(), chair()
    others = [each for each in scene.info.instances if each.id != target.instance_id]
    own = Instance(id=target.instance_id, prim_path=target.prim_path, category=target.category)
    instances, targets = (own, *others), (target, *scene.info.targets)
    info = scene.info.model_copy(update={"name": "office", "targets": targets, "instances": instances})
    return dataclasses.replace(scene, info=info, spawn_sees=np.ones((len(scene.spawns), len(targets)), np.uint8))


@pytest.fixture(scope="module")
def source(tmp_path_factory) -> Path:
    root = tmp_path_factory.mktemp("relabel") / "data"
    make_dataset(root, episodes=6, splits=SPLITS, package=encode_scene(scene_with_the_chair()))
    return root


@pytest.fixture(scope="module")
def relabelled(source) -> Path:
    out = source.with_name("new")
    relabel(source, out, SPEC)
    return out


def test_every_new_instruction_fits_its_target_only_and_the_dataset_is_valid(source, relabelled):
    scene = SceneLanguage(build_graph(scene_with_the_chair()))
    dataset, rows = Dataset(relabelled), Dataset(relabelled).instructions.to_pylist()
    goals = [row for row in rows if row["kind"] == "goal"]
    assert len(goals) == 12
    for row in goals:
        summary = dataset[row["episode_id"]].summary
        pose = (summary.spawn_x_m, summary.spawn_y_m, summary.spawn_yaw_rad)
        view, number = look(scene.graph, pose, CameraConfig()), scene.graph.number_of[summary.target_id]
        assert scene.verifier.check(row["instruction"], reader(row["language"]), view, number) == ""
        assert row["held_out"] == (summary.split is Split.TEST_PARAPHRASE_OOD)
    assert {row["kind"] for row in rows} == {"goal", "false_premise"}
    firsts = {row["episode_id"]: row["instruction"] for row in rows if row["number"] == 1}
    assert {episode.episode_id: episode.instruction for episode in dataset} == firsts
    assert dataset.digest == Dataset(source).digest
    assert verify(relabelled, deep=True).findings == verify(source, deep=True).findings


def test_every_question_is_stored_with_its_episode_and_accepted_by_the_verifier(source, relabelled):
    scene, dataset = SceneLanguage(build_graph(scene_with_the_chair())), Dataset(relabelled)
    rows = dataset.questions.to_pylist()
    assert {row["kind"] for row in rows} >= {"object", "visible", "feasible"}
    for row in rows:
        with dataset[row["episode_id"]] as episode:
            number = scene.graph.number_of[episode.summary.target_id]
            verifier = QuestionVerifier(SceneRoutes(scene, CameraConfig()), episode.poses, number)
            names = set(Question.model_fields) - {"meaning"}
            asked = Question(**{name: row[name] for name in names}, meaning=json.loads(row["meaning"]))
            assert verifier.check(asked, reader(row["language"]), episode) == ""
    assert dataset.filter(episode=rows[0]["episode_id"]).questions.num_rows < len(rows)
    with pytest.raises(UsageError, match="has no questions: `factory relabel` with questions = true"):
        _ = Dataset(source).questions


def test_the_source_keeps_its_files_and_instructions(source, relabelled):
    assert {episode.instruction for episode in Dataset(source)} != {
        episode.instruction for episode in Dataset(relabelled)
    }
    with pytest.raises(UsageError, match="has its recorded instructions only"):
        _ = Dataset(source).instructions


def test_an_interrupted_call_continues_and_gives_the_same_instructions(source, relabelled, tmp_path):
    stop = threading.Event()
    stop.set()
    first = relabel(source, tmp_path / "out", SPEC, stop=stop)
    again = relabel(source, tmp_path / "out", SPEC)
    third = relabel(source, tmp_path / "out", SPEC)
    assert (first.finished, again.finished) == (False, True)
    assert third.model_copy(update={"rejected": again.rejected}) == again
    names = ("instructions.parquet", "metadata.parquet", "questions.parquet")
    tables = [[pq.read_table(root / name) for name in names] for root in (relabelled, tmp_path / "out")]
    assert tables[0] == tables[1]
    assert not (tmp_path / "out" / ".export").exists()


def test_another_language_file_or_foreign_directory_is_refused(source, relabelled, tmp_path):
    with pytest.raises(UsageError, match="was relabelled with a different language file"):
        relabel(source, relabelled, LanguageSpec(seed=1))
    (tmp_path / "note.txt").write_text("mine")
    with pytest.raises(UsageError, match="is not a relabelled dataset"):
        relabel(source, tmp_path, SPEC)
    assert [path.name for path in tmp_path.iterdir()] == ["note.txt"]


def test_drawing_the_target_at_the_start_is_refused_for_recorded_episodes(source, tmp_path):
    with pytest.raises(InvalidLanguage, match="exchangeable: a plan can draw the target at the start"):
        relabel(source, tmp_path / "out", LanguageSpec(exchangeable=True, in_view=1))
    assert not (tmp_path / "out").exists()


def test_the_error_of_a_language_file_that_no_target_satisfies_names_the_possible_values(source, tmp_path):
    only_support = LanguageSpec(features={str(each): 0.0 for each in Family if each is not Family.SUPPORT})
    with pytest.raises(
        InvalidLanguage,
        match=r"scene office: no instruction with these features fits .*; features possible in this scene: .*ordinal",
    ):
        relabel(source, tmp_path / "out", only_support)
    with pytest.raises(InvalidLanguage, match=r"at most [0-9]+ other objects"):
        relabel(source, tmp_path / "out", LanguageSpec(same_category=99))
    assert not (tmp_path / "out").exists()


def test_an_episode_without_a_fitting_instruction_keeps_the_recorded_one():
    start = LanguageStart(
        "ep_000001", 1, "train_id", "chair_001", "chair", (0.0, 0.0, 0.0), "Go to the chair.", "train_01"
    )
    (row,) = rows_of(start, [])
    assert (row["kind"], row["instruction"], row["template_id"], row["number"]) == (
        "recorded",
        "Go to the chair.",
        "train_01",
        1,
    )


def test_the_command_prints_the_report_as_json(source, tmp_path, capsys):
    (tmp_path / "language.toml").write_text("per_episode = 1\n")
    arguments = [str(source), "-o", str(tmp_path / "out"), "--language", str(tmp_path / "language.toml"), "--json"]
    assert command.main([*arguments, "--workers", "1"], standalone_mode=False) == 0
    assert '"finished": true' in capsys.readouterr().out


def test_a_feature_of_limited_share_is_in_at_most_that_share_of_the_new_instructions(source, tmp_path):
    kept = Family.ORDINAL, Family.NEAREST, Family.COLOUR
    others = {family: 0.0 for family in Family if family not in kept}
    spec = LanguageSpec(features={**others, Family.ORDINAL: 1e6}, seed=3)
    counts = []
    for limits in ({}, {Family.ORDINAL: 0.34}):
        out = tmp_path / f"limits{len(limits)}"
        relabel(source, out, spec.model_copy(update={"largest_shares": limits}))
        rows = Dataset(out).instructions.to_pylist()
        counts.append(sum("ordinal" in row["features"].split(",") for row in rows if row["kind"] == "goal"))
    assert counts[0] > 2 >= counts[1]  # of 6 episodes
