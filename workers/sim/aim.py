"""Determines target and sentence of an episode at its start, and questions at its end. Draws no start pose.

Design: docs/design/language.md#the-sentence-is-written-when-the-start-is-known.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

from schemas.exchangeable import candidates_of, exchangeable_targets, may_exchange
from schemas.instruction.start_view import start_view_findings
from schemas.job import Job
from schemas.language.expression import Family
from schemas.language.instruction import Instruction, InstructionKind
from schemas.language.language_file import LED_STARTS
from schemas.language.question.meaning import Question
from schemas.measure import Goal, target_in_view
from schemas.scene import SceneInfo, Target
from schemas.support.numpy_types import Floats
from workers.experts import Expert, make_expert
from workers.experts.planner import STOPPED_M, arrival_pose
from workers.geometry.pose import Pose
from workers.planning import Waypoint
from workers.render import Renderer, as_partial
from workers.sim.context import LoadedScene


def write_instruction(job: Job, scene: LoadedScene, start: Pose) -> Instruction | None:
    """Returns the instruction of a job from its start pose; the result depends on job, scene and pose only.

    Args:
        job: job with parameters of the language.
        scene: scene of the job.
        start: pose of base_link at rest.

    Returns:
        The instruction; `None` if the job has a template, or if every sentence also fits other objects.
    """
    if job.language is None:
        return None
    from schemas.language.compose import composer_of  # imported here, because it imports scipy
    from schemas.language.graph.view import look

    language = scene.language
    view = look(language.graph, (start.x, start.y, start.yaw), job.camera)
    number, held_out = language.graph.number_of[job.target_id], job.split.is_paraphrased
    composer, rng = composer_of(job.language), job.language_rng()
    if job.is_false_premise:
        return composer.write_false_premise(language, view, number=number, held_out=held_out, rng=rng)
    instructions = composer.write(language, view, number, held_out, rng)
    return instructions[0] if instructions else None


def write_questions(
    job: Job, scene: LoadedScene, poses: Floats, instruction: Instruction | None
) -> tuple[Question, ...]:
    """Returns the questions about an episode; the result depends on job, scene and poses only.

    Args:
        job: job with parameters of the language.
        scene: scene of the job.
        poses: (T, 7) recorded poses of base_link.
        instruction: instruction of the episode.
    """
    if job.language is None or not job.language.questions:
        return ()
    from schemas.language.compose import composer_of
    from schemas.language.question.compose import AskedEpisode, QuestionComposer
    from schemas.language.route.steps import SceneRoutes

    goals = () if instruction is None or instruction.kind is not InstructionKind.GOAL else (instruction,)
    episode = AskedEpisode(poses, scene.language.graph.number_of[job.target_id], goals, job.is_false_premise)
    composer = QuestionComposer(composer_of(job.language))
    routes, rng = SceneRoutes(scene.language, job.camera), job.question_rng()
    return tuple(composer.write(routes, episode, job.split.is_paraphrased, rng))


@dataclass(frozen=True)
class EpisodeAim:
    """Target and sentence of an episode."""

    job: Job
    """Job with this target."""
    target: Target
    instruction: Instruction | None
    """Verified instruction; `None` if the job has a template."""
    choices: tuple[int, ...] = ()
    """Ids of the objects that could be the target; empty if the plan names it."""
    begun: tuple[Expert, tuple[Waypoint, ...]] | None = None
    """Expert that started there, and its path, if the search for the target has planned it."""


def start_target(job: Job, info: SceneInfo) -> Target:
    """Returns the object around which the starts of a job are drawn."""
    if job.choice is None:
        return info.target(job.target_id)
    return next(each for each in info.targets if each.instance_id == job.choice.around)


class Choices:
    """The objects that could be the target from a pose; the image of the last pose is rendered once.

    Args:
        job: job of the episode.
        info: scene of the job.
        renderer: renderer with the scene loaded.
    """

    def __init__(self, job: Job, info: SceneInfo, renderer: Renderer) -> None:
        self._job, self._info, self._renderer = job, info, renderer
        self._last: tuple[Pose, tuple[Target, ...]] | None = None

    def at(self, pose: Pose) -> tuple[Target, ...]:
        """Returns the objects; none if there are fewer than the job requires."""
        # the view, the sentences and the aim of a start are tested at one pose, and rendering takes most of the time
        if self._last is None or self._last[0] != pose:
            self._last = pose, self._find(pose)
        return self._last[1]

    def _find(self, pose: Pose) -> tuple[Target, ...]:
        job, info = self._job, self._info
        assert job.start_view is not None
        candidates, start, least = (
            candidates_of(job, info),
            (pose.x, pose.y, pose.yaw),
            job.start_view.least_same_category,
        )
        if not may_exchange(job, candidates, start, least + 1):
            return ()
        choices = exchangeable_targets(job, candidates, start, self._renderer.render_depth_and_ids(pose).ids)
        return choices if len(choices) > least else ()


def is_view_clear(job: Job, info: SceneInfo, renderer: Renderer, pose: Pose, choices: Choices | None = None) -> bool:
    """Returns whether heading and image of a pose meet the job's conditions; renders only what is needed.

    `choices` may contain the objects that could be the target from that pose.
    """
    view, least = job.start_view, job.gains.min_mask_px
    if view is None:
        return True
    if view.choice is not None:
        return bool((choices or Choices(job, info, renderer)).at(pose))
    target = info.target(job.target_id)
    instance_id = target.instance_id
    x, y, _ = target.centroid_m
    bearing_rad = math.remainder(math.atan2(y - pose.y, x - pose.x) - pose.yaw, 2 * math.pi)
    if view.within_rad is not None and abs(bearing_rad) > view.within_rad:
        return False
    parts = as_partial(renderer)
    if parts is not None:
        is_shown = target_in_view(parts.render_instance(pose, instance_id)[1].ids, instance_id, least)
        is_wanted = is_shown or not view.shows_target
        if not (is_wanted and ((view.other_referents or view.least_same_category) if is_shown else view.same_category)):
            return is_wanted
    image = renderer.render_depth_and_ids(pose)
    return not start_view_findings(
        view,
        instance_id,
        bearing_rad=bearing_rad,
        ids=image.ids,
        depth=image.depth,
        camera=job.camera,
        min_pixels=least,
    )


class SentenceSearch:
    """Test of starts for the sentences of a job, before the physics.

    If the feature that leads the sentence has a weight above the mean, the first starts must permit it. Otherwise a
    feature that few starts permit would be rare, whatever its weight.

    Args:
        job: job of the episode.
        scene: scene of the job.
        choices: the objects that could be the target.
    """

    def __init__(self, job: Job, scene: LoadedScene, choices: Choices) -> None:
        self._job, self._scene, self._choices = job, scene, choices
        self._leading = _leading_feature(job)
        self._rejected: list[Pose] = []

    def accepts(self, pose: Pose) -> bool:
        """Returns whether each object that could be the target from a pose whose view is clear has a sentence."""
        job, scene = self._job, self._scene
        if job.choice is None and self._leading is None:
            return True  # the sentence is written after the physics
        targets = [scene.compiled.info.target(job.target_id)]
        if job.choice is not None:
            targets = list(self._choices.at(pose))
        sentences = [write_instruction(job.aimed_at(target), scene, pose) for target in targets]
        if not sentences or not all(sentences):
            return False
        drawn = sentences[0] if job.choice is None else job.choice.of(sentences)
        is_led = self._leading is None or (drawn is not None and self._leading in drawn.named_features)
        if is_led or len(self._rejected) == LED_STARTS:
            return True
        self._rejected.append(pose)
        return False

    def rejected_starts(self) -> Iterator[Pose]:
        """Yields the starts that were rejected only because the leading feature is not in the sentence."""
        yield from self._rejected


def _leading_feature(job: Job) -> Family | None:
    if job.language is None or job.is_false_premise or not job.language.is_weighted:
        return None
    from schemas.language.compose import composer_of

    return composer_of(job.language).leading_feature(job.language_rng())


def find_aim(job: Job, scene: LoadedScene, renderer: Renderer, pose: Pose, choices: Choices) -> EpisodeAim | None:
    """Returns the target and the sentence of an episode that starts at a pose.

    If the target is drawn at the start, each object that could be the target must have a sentence and a path.
    Without this rule, objects for which sentences and paths are easy to find would be targets more often.

    Args:
        job: job of the episode.
        scene: scene of the job.
        renderer: renderer with the scene loaded.
        pose: pose of base_link at rest, whose view is clear.
        choices: the objects that could be the target.

    Returns:
        Target and sentence; `None` if a sentence also fits other objects, or if an object that could be the target has
        no path or is not in view at the end of its path.
    """
    if job.choice is None:
        instruction = write_instruction(job, scene, pose)
        is_missing = instruction is None and job.language is not None
        return None if is_missing else EpisodeAim(job, scene.compiled.info.target(job.target_id), instruction)
    targets = choices.at(pose)
    aims = [
        _exchangeable_aim(job, target, targets=targets, scene=scene, renderer=renderer, pose=pose) for target in targets
    ]
    return job.choice.of(aims) if aims and all(aims) else None


def _exchangeable_aim(
    job: Job, target: Target, targets: tuple[Target, ...], scene: LoadedScene, renderer: Renderer, pose: Pose
) -> EpisodeAim | None:
    """Returns the aim with this target; `None` if it has no sentence or path, or is not in view at the path's end."""
    aimed_job = job.aimed_at(target)
    instruction = write_instruction(aimed_job, scene, pose)
    expert = make_expert(aimed_job)
    planned = None if instruction is None else expert.begin(pose, scene.grid, target)
    if planned is None or not ends_in_view(aimed_job, target, scene=scene, renderer=renderer, planned=planned):
        return None
    choices = tuple(each.instance_id for each in targets)
    return EpisodeAim(aimed_job, target, instruction, choices=choices, begun=(expert, planned))


def ends_in_view(
    job: Job, target: Target, scene: LoadedScene, renderer: Renderer, planned: tuple[Waypoint, ...]
) -> bool:
    """Returns whether the target is in view at the end of a planned path.

    Also returns `True` if the job does not require this, and without a planned path, because the view at the end is
    then known only after the attempt.
    """
    if not (planned and job.demonstration.target_in_view):
        return True
    goal = Goal.of(target, job.task)
    x, y, yaw = arrival_pose(planned, goal, goal.radius_m - STOPPED_M)
    end = Pose.planar(x, y, yaw, z=scene.compiled.info.floor_height_m)
    return target_in_view(renderer.render_depth_and_ids(end).ids, target.instance_id, job.gains.min_mask_px)
