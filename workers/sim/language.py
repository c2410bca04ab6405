"""Writes the verified instruction of a job at the start of its episode, and questions at its end."""

from __future__ import annotations

from schemas.job import Job
from schemas.language.instruction import Instruction, InstructionKind
from schemas.language.question.model import Question
from schemas.support.numpy_types import Floats
from workers.geometry.pose import Pose
from workers.sim.scene_renderer import LoadedScene


def write_instruction(job: Job, place: LoadedScene, start: Pose) -> Instruction | None:
    """Returns the instruction of a job from its start pose; the result depends on job, scene and pose only.

    Args:
        job: job with parameters of the language.
        place: scene of the job.
        start: pose of base_link at rest.

    Returns:
        The instruction; `None` if the job has a template, or if every sentence also fits other objects.
    """
    if job.language is None:
        return None
    from schemas.language.compose import composer_of  # imported here, because it imports scipy
    from schemas.language.graph.view import look

    scene = place.language
    view = look(scene.graph, (start.x, start.y, start.yaw), job.camera)
    number, held_out = scene.graph.number_of[job.target_id], job.split.is_paraphrased
    composer, rng = composer_of(job.language), job.language_rng()
    if job.is_false_premise:
        return composer.write_false_premise(scene, view, number, held_out, rng)
    found = composer.write(scene, view, number, held_out, rng)
    return found[0] if found else None


def write_questions(job: Job, place: LoadedScene, poses: Floats, said: Instruction | None) -> tuple[Question, ...]:
    """Returns the questions about an episode; the result depends on job, scene and poses only.

    Args:
        job: job with parameters of the language.
        place: scene of the job.
        poses: (T, 7) recorded poses of base_link.
        said: instruction of the episode.
    """
    if job.language is None or not job.language.questions:
        return ()
    from schemas.language.compose import composer_of
    from schemas.language.question.compose import AskedEpisode, QuestionComposer
    from schemas.language.route.steps import SceneRoutes

    goals = () if said is None or said.kind is not InstructionKind.GOAL else (said,)
    asked = AskedEpisode(poses, place.language.graph.number_of[job.target_id], goals, job.is_false_premise)
    composer = QuestionComposer(composer_of(job.language))
    routes, rng = SceneRoutes(place.language, job.camera), job.question_rng()
    return tuple(composer.write(routes, asked, job.split.is_paraphrased, rng))
