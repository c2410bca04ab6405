"""Checks the verified instruction of an episode against its scene with the verifier. Writes no instruction."""

from __future__ import annotations

from pathlib import Path

from coordinator.expansion.sentences import scene_language
from schemas.episode import EpisodeMeta
from schemas.job import Job
from schemas.language.compose import composer_of
from schemas.language.instruction import Instruction
from schemas.language.view import look


def sentence_findings(job: Job, said: Instruction, start: tuple[float, float, float], package: Path) -> list[str]:
    """Returns why the sentence of an instruction does not fit the target from the start; empty if it does.

    Args:
        job: job of the episode, with parameters of the language.
        said: instruction of the episode.
        start: x, y in metres and yaw in radians of base_link at frame 0.
        package: package of the scene.

    Raises:
        InvalidBundle: the package is damaged.
    """
    assert job.language is not None
    scene, composer = scene_language(package), composer_of(job.language)
    if said.template_id not in composer.patterns_of(said.language, said.held_out):
        return [f"instruction: pattern {said.template_id!r} does not exist in split {job.split}"]
    number = scene.graph.number_of[job.target_id]
    view = look(scene.graph, start, job.camera)
    reader = composer.reader(said.language)
    if job.is_false_premise:
        is_absent = scene.verifier.is_false_premise(said.text, reader, view)
        fault = "" if is_absent else "an object of the scene fits, or may fit"
    else:
        fault = scene.verifier.check(said.text, reader, view, number)
    found = [f"instruction {said.text!r}: {fault}"] if fault else []
    if said.distractors != scene.distractors(number):
        found.append(f"distractors {said.distractors}, the scene has {scene.distractors(number)}")
    return found


def said_findings(meta: EpisodeMeta, package: Path | None) -> list[str]:
    """Returns all findings about the verified instruction of an episode; none if it has a template."""
    if meta.language is None or meta.job.language is None or package is None:
        return []
    return sentence_findings(meta.job, meta.language, meta.rollout.spawn_pose, package)
