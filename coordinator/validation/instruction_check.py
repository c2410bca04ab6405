"""Checks the verified instruction and the questions of an episode against its scene. Writes no text."""

from __future__ import annotations

from pathlib import Path

from coordinator.expansion.offers import scene_language
from schemas.bundle import BundleReader
from schemas.job import Job
from schemas.language.compose import composer_of
from schemas.language.graph.view import look
from schemas.language.instruction import Instruction
from schemas.language.language_file import LanguageSpec
from schemas.language.question.verify import QuestionVerifier
from schemas.language.route.steps import SceneRoutes
from schemas.language.sentence.mistakes import mistake_fault
from schemas.language.sentence.reading import Reader
from schemas.terms import Recording


def sentence_findings(
    job: Job, instruction: Instruction, start: tuple[float, float, float], package: Path
) -> list[str]:
    """Returns why the sentence of an instruction does not fit the target from the start; empty if it does.

    Args:
        job: job of the episode, with parameters of the language.
        instruction: instruction of the episode.
        start: x, y in metres and yaw in radians of base_link at frame 0.
        package: package of the scene.

    Raises:
        InvalidBundle: the package is damaged.
    """
    assert job.language is not None
    scene, composer = scene_language(package), composer_of(job.language)
    if instruction.template_id not in composer.patterns_of(instruction.language, instruction.held_out):
        return [f"instruction: pattern {instruction.template_id!r} does not exist in split {job.split}"]
    number = scene.graph.number_of[job.target_id]
    view = look(scene.graph, start, job.camera)
    reader = composer.reader(instruction.language)
    if job.is_false_premise:
        is_absent = scene.verifier.is_false_premise(instruction.meant, reader, view)
        fault = "" if is_absent else "an object of the scene fits, or may fit, although the premise should be false"
    else:
        fault = scene.verifier.check(instruction.meant, reader, view, number)
    if instruction.clean is not None and not fault:
        fault = _mistake_fault(instruction, job.language, reader)
    findings = [f"instruction {instruction.text!r}: {fault}"] if fault else []
    if instruction.distractors != scene.distractors(number):
        findings.append(
            f"the instruction records {instruction.distractors} distractors, but the scene has "
            f"{scene.distractors(number)}"
        )
    return findings


def _mistake_fault(instruction: Instruction, spec: LanguageSpec, reader: Reader) -> str:
    """Returns why the recorded kind of error is not planned, or does not explain the sentence; empty if it does."""
    assert instruction.clean is not None
    if instruction.mistake is None or not spec.mistakes.get(instruction.mistake):
        return "its error is not planned"
    return mistake_fault(
        instruction.text,
        instruction.clean,
        kind=instruction.mistake,
        code=instruction.language,
        vocabulary=reader.vocabulary,
    )


def said_findings(bundle: BundleReader, package: Path | None) -> list[str]:
    """Returns all findings about the verified instruction and the questions of an episode.

    Returns none if the instruction comes from a template, or without a package.

    Args:
        bundle: valid bundle of the episode.
        package: package of the scene, or `None`.

    Raises:
        InvalidBundle: the package or the images of a question are damaged.
    """
    meta = bundle.meta
    if meta.language is None or meta.job.language is None or package is None:
        return []
    findings = sentence_findings(meta.job, meta.language, meta.rollout.spawn_pose, package)
    return findings + (_question_findings(bundle, meta.job, package) if meta.questions else [])


def _question_findings(bundle: BundleReader, job: Job, package: Path) -> list[str]:
    assert job.language is not None
    scene, composer = scene_language(package), composer_of(job.language)
    images = bundle if job.record is Recording.FRAMES else None
    place, number = SceneRoutes(scene, job.camera), scene.graph.number_of[job.target_id]
    verifier = QuestionVerifier(place, bundle.arrays.poses, number)
    faults = [(each, verifier.check(each, composer.reader(each.language), images)) for each in bundle.meta.questions]
    return [f"question {each.question!r}, answer {each.answer!r}: {fault}" for each, fault in faults if fault]
