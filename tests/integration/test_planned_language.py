"""Planned episodes with verified instructions and false premises: simulated, validated and compared with the scene."""

from __future__ import annotations

import hashlib
from pathlib import Path

import pytest

from coordinator.validation.instruction_check import said_findings, sentence_findings
from coordinator.validation.validate import validate
from schemas.bundle import BundleReader
from schemas.config import SpawnConfig, TaskConfig
from schemas.instruction.templates import FROM_START, instruction
from schemas.job import Job
from schemas.language.instruction import Instruction, InstructionKind
from schemas.language.language_file import LanguageSpec
from schemas.language.question.meaning import QuestionKind
from schemas.scene import encode_scene
from schemas.terms import ExpertName, Recording, Split, Tier
from tests.builders.attempts import first_success, loaded_renderer, write_package
from tests.builders.bundle import job_for
from tests.builders.language import furnished_scene
from workers.sim.context import SimulationContext

SCENE = furnished_scene()
CHAIR, OTHER = SCENE.info.targets[:2]
PACKAGE = encode_scene(SCENE, level=1)


@pytest.fixture(scope="module")
def package(tmp_path_factory) -> Path:
    return write_package(tmp_path_factory.mktemp("scene"), PACKAGE)


@pytest.fixture(scope="module")
def stage(package):
    with loaded_renderer(package) as renderer:
        yield renderer


def _job(split: Split, attempt: int = 1) -> Job:
    return job_for(
        attempt=attempt,
        scene=SCENE.info.name,
        scene_sha256=hashlib.sha256(PACKAGE).hexdigest(),
        tier=Tier.NEAR,
        split=split,
        category="chair",
        colour="red",
        template_id=FROM_START,
        instruction=instruction(FROM_START, "chair", "red"),
        target_id=CHAIR.target_id,
        expert=ExpertName.PLANNER,
        task=TaskConfig(success_radius_m=1.4, hold_steps=2, control_hz=10),
        spawn=SpawnConfig(heading_noise_rad=0.4),
        language=LanguageSpec(questions=True),
        record=Recording.STATES,
    )


def _episode(stage: SimulationContext, split: Split) -> BundleReader:
    """Returns the first successful attempt."""
    return first_success((_job(split, attempt) for attempt in range(1, 8)), stage)[1]


def _said(bundle: BundleReader) -> Instruction:
    assert bundle.meta.language is not None
    return bundle.meta.language


@pytest.mark.parametrize("split", [Split.TRAIN_ID, Split.TEST_PARAPHRASE_OOD])
def test_an_episode_records_a_sentence_that_fits_its_target_only(stage, package, split):
    with _episode(stage, split) as bundle:
        said, meta = _said(bundle), bundle.meta
        assert validate(bundle, meta.job, (CHAIR,)) == []
        assert said_findings(bundle, package) == []
        assert meta.instruction == said.text
        assert meta.phrase_is_unique
        assert said.held_out == (split is Split.TEST_PARAPHRASE_OOD)
        assert {each.meaning.kind for each in meta.questions} >= {QuestionKind.NEXT, QuestionKind.OBJECT}
        wrong_answers = tuple(each.model_copy(update={"answer": "I turn around."}) for each in meta.questions)
        bundle.meta = meta.model_copy(update={"questions": wrong_answers})
        assert len(said_findings(bundle, package)) == len(wrong_answers)
        wrong = said.model_copy(update={"text": "Go to the green chair."})
        found = sentence_findings(meta.job, wrong, meta.rollout.spawn_pose, package)
        assert "it does not fit the target" in found[0]
        moved = said.model_copy(update={"template_id": "en_terse_999"})
        assert "does not exist" in sentence_findings(meta.job, moved, meta.rollout.spawn_pose, package)[0]


def test_the_sentence_of_a_job_is_the_same_each_time(stage):
    with _episode(stage, Split.TRAIN_ID) as one, _episode(stage, Split.TRAIN_ID) as two:
        assert one.meta.content_digest == two.meta.content_digest


def test_the_robot_stops_at_its_start_if_the_named_object_does_not_exist(stage, package):
    with _episode(stage, Split.TEST_FALSE_PREMISE) as bundle:
        said, meta = _said(bundle), bundle.meta
        assert (said.kind, said.fits) == (InstructionKind.FALSE_PREMISE, 0)
        assert validate(bundle, meta.job, (CHAIR,)) == []
        assert said_findings(bundle, package) == []
        assert bundle.length == meta.job.task.control_hz + 1
        assert not bundle.arrays.actions_continuous.any()
        there = said.model_copy(update={"text": "Go to the chair."})
        assert "an object of the scene fits" in sentence_findings(meta.job, there, meta.rollout.spawn_pose, package)[0]


def test_an_episode_without_the_planned_sentence_is_refused(stage):
    with _episode(stage, Split.TEST_FALSE_PREMISE) as bundle:
        bundle.meta = bundle.meta.model_copy(update={"language": None})
        assert "the episode has no verified instruction" in validate(bundle, bundle.meta.job, (CHAIR,))


@pytest.mark.parametrize("feature", ["near", "support"])
def test_a_start_is_searched_for_the_feature_of_large_weight_and_another_is_used_if_none_is_found(stage, feature):
    language = LanguageSpec(features={feature: 1e6})
    jobs = (_job(Split.TRAIN_ID, attempt).model_copy(update={"language": language}) for attempt in range(1, 8))
    with first_success(jobs, stage)[1] as bundle:
        # nothing is on or under the chair, which is next to a table
        assert (feature in _said(bundle).named_features) == (feature == "near")
