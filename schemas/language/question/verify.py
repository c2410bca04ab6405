"""Decides whether a question has the right answer and reason: reads the text, replays the poses, measures polygons.

Also compares a question with the recorded ids and depth of its frame. Independent of the code that computes answers,
except that both use the scene graph, the thresholds and the words.
"""

from __future__ import annotations

import cmath
import math
from collections.abc import Collection
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from schemas.config import CameraConfig
from schemas.instruction.start_view import SeenObject, see_objects
from schemas.language import thresholds as limit
from schemas.language.graph.scene_graph import SceneGraph
from schemas.language.graph.view import look
from schemas.language.question.meaning import (
    AnswerKind,
    Question,
    QuestionKind,
    QuestionMeaning,
    ReasonKind,
    SeenSide,
)
from schemas.language.question.reading import question_reader
from schemas.language.route import thresholds as route
from schemas.language.route.replay import PoseReplay
from schemas.language.route.steps import SceneRoutes
from schemas.language.route.thresholds import METRES
from schemas.language.sentence.reading import Reader
from schemas.language.verifier.measure import Truth, at_least, at_most
from schemas.support.geometry import footprint_distances

_CLEAR_PX, _HIDDEN_PX = 60, 12
"""`_CLEAR_PX`: minimum number of pixels of an object that an answer calls visible. `_HIDDEN_PX`: maximum number of
pixels of the objects that an answer calls not visible. Images have 640 x 640 pixels."""
_SIDE_RAD = math.radians(8)
"""Tolerance of the direction to an object, radians. The middle of its mask moves if other objects hide a part of it."""
_METRES_FREE = 0.4
"""Absolute part of the tolerance of distances, metres: the nearest visible point of an object may be above the middle
of its footprint instead of at the edge."""


class FrameImages(Protocol):
    """Source of the recorded images of an episode, such as `Episode` or `BundleReader`."""

    def ids(self, t: int) -> NDArray[np.uint16]:
        """Returns the (640, 640) instance ids at frame t."""

    def depth(self, t: int) -> NDArray[np.float32]:
        """Returns the (640, 640) depth at frame t, metres."""


def image_fault(
    meaning: QuestionMeaning,
    fitting: Collection[int],
    images: FrameImages,
    t: int,
    graph: SceneGraph,
    camera: CameraConfig,
) -> str:
    """Returns why the images of a frame contradict an answer about what is visible; empty if they do not.

    Args:
        meaning: meaning of question, answer and reason.
        fitting: numbers of the objects that question or answer name, or may name.
        images: images of the episode.
        t: frame.
        graph: scene graph.
        camera: camera of the images.
    """
    ids = images.ids(t)
    parts = [part for number in fitting for part in graph.objects[number].ids]
    is_shown = meaning.answer in (AnswerKind.YES, AnswerKind.THERE, AnswerKind.OBJECT)
    if not is_shown:
        if meaning.reason in (ReasonKind.NONE_EXISTS, ReasonKind.NOT_IN_VIEW) or meaning.answer is AnswerKind.UNSEEN:
            return "the image shows such an object" if np.isin(ids, parts).sum() > _HIDDEN_PX else ""
        return ""
    seen = see_objects(ids, images.depth(t), objects=parts, camera=camera, min_pixels=_CLEAR_PX)
    if not any(_is_at(each, meaning) for each in seen):
        return "the image shows no such object at this side and distance" if seen else "the image shows no such object"
    return ""


def _is_at(each: SeenObject, meaning: QuestionMeaning) -> bool:
    left = -each.bearing_rad
    match meaning.side:
        case SeenSide.LEFT:
            is_there = left >= limit.EGO_RAD.good - _SIDE_RAD
        case SeenSide.RIGHT:
            is_there = -left >= limit.EGO_RAD.good - _SIDE_RAD
        case _:
            is_there = abs(left) <= limit.AHEAD_RAD.good + _SIDE_RAD
    if meaning.metres is None:
        return is_there
    return is_there and abs(each.range_m - meaning.metres) <= METRES.good * each.range_m + _METRES_FREE


_FAR_M = 12.0
_TURNED_RAD = math.radians(28)
_STILL_M = 0.15
_TARGET_SIDE = {
    ReasonKind.GOAL_LEFT: SeenSide.LEFT,
    ReasonKind.GOAL_RIGHT: SeenSide.RIGHT,
    ReasonKind.GOAL_AHEAD: SeenSide.AHEAD,
}
_EXPECTED = {
    (AnswerKind.YES, ReasonKind.ONE_FITS),
    (AnswerKind.NO, ReasonKind.NONE_FITS),
    (AnswerKind.NO, ReasonKind.SEVERAL_FIT),
}


class QuestionVerifier:
    """Verifier of questions about one episode.

    Args:
        place: scene prepared for routes.
        poses: (T, 7) recorded poses of base_link in the world frame.
        target: number of the target in the scene graph.
    """

    def __init__(self, place: SceneRoutes, poses: NDArray[np.float64], target: int) -> None:
        self._place, self._graph, self._target = place, place.scene.graph, target
        self._expressions, self._camera = place.scene.verifier, place.camera
        self._replay = PoseReplay(self._graph, poses, place.camera)

    def check(self, question: Question, language: Reader, images: FrameImages | None = None) -> str:
        """Returns why the answer or the reason is wrong; empty if every reading of the texts is right.

        Args:
            question: question, answer, reason and frames; the recorded meaning is not used.
            language: reader of referring expressions of its language.
            images: recorded instance ids and depth; `None` if the episode has none.
        """
        start, end = question.start, question.end
        if not 0 <= start < end <= len(self._replay):
            return "the frames do not exist"
        reader = question_reader(question.language, language)
        readings = reader.read(question.question, question.answer, question.reason)
        if not readings:
            return "the texts do not match the patterns of the language"
        return next(filter(None, (self._fault(each, start, end, language, images) for each in readings)), "")

    def _fault(
        self, meaning: QuestionMeaning, start: int, end: int, language: Reader, images: FrameImages | None
    ) -> str:
        match meaning.kind:
            case QuestionKind.FEASIBLE:
                return self._feasible_fault(meaning, language) if start == 0 else "the question is not about frame 0"
            case QuestionKind.NEXT:
                return self._movement_fault(meaning.answer, start, end) or self._reason_fault(meaning, start, end)
        if end != start + 1:
            return "the question is about more than one frame"
        fitting, fault = self._seen_fault(meaning, start)
        if fault or images is None:
            return fault
        return image_fault(meaning, fitting, images=images, t=start, graph=self._graph, camera=self._camera)

    def _seen_fault(self, meaning: QuestionMeaning, t: int) -> tuple[Collection[int], str]:
        """Returns the objects that question or answer may name, and why the answer about a view is wrong (empty if it
        is right)."""
        if meaning.kind is QuestionKind.WHERE:
            return [self._target], self._where_fault(meaning, t)
        if meaning.named is None:
            return [], "no object is named"
        fitting = self._expressions.evaluate(meaning.named.model_copy(update={"definite": False}), None)
        if meaning.answer is AnswerKind.NO:
            return fitting.possible, self._absence_fault(meaning, fitting.sure, fitting.possible, t)
        if meaning.answer not in (AnswerKind.YES, AnswerKind.OBJECT) or meaning.side is None:
            return [], "the answer does not belong to the question"
        there = [number for number in sorted(fitting.sure) if self._is_at(number, meaning, t)]
        return there, "" if there else "no such object is there"

    def _absence_fault(self, meaning: QuestionMeaning, sure: Collection[int], possible: Collection[int], t: int) -> str:
        if any(self._replay.may_see(number, t, _FAR_M) for number in possible):
            return "such an object may be visible"
        if meaning.reason is ReasonKind.NONE_EXISTS:
            return "such an object may exist" if possible else ""
        if meaning.reason is ReasonKind.NOT_IN_VIEW:
            return "" if sure else "it is not certain that such an object exists"
        return "the reason does not belong to the answer"

    def _where_fault(self, meaning: QuestionMeaning, t: int) -> str:
        if meaning.answer is AnswerKind.THERE:
            return "" if self._is_at(self._target, meaning, t) else "the target is not there"
        if meaning.answer is not AnswerKind.UNSEEN:
            return "the answer does not belong to the question"
        if self._replay.may_see(self._target, t, 99.0):
            return "the target may be visible"
        room, target_room = self._replay.room(t), self._graph.objects[self._target].room
        is_outside = min(abs(angle) for angle in self._bearings(self._target, t)) > self._half + limit.EDGE_RAD / 2
        match meaning.reason:
            case ReasonKind.OTHER_ROOM:
                return "" if room and target_room and room != target_room else "the target may be in this room"
            case ReasonKind.OUTSIDE:
                return "" if is_outside else "the target is not outside of the image"
            case ReasonKind.HIDDEN:
                return "the target is outside of the image" if is_outside else ""
            case _:
                return "the reason does not belong to the answer"

    def _is_at(self, number: int, meaning: QuestionMeaning, t: int) -> bool:
        """Returns whether an object is surely visible on a side, and at a distance if one is named."""
        if meaning.side is None or not self._is_shown(number, t):
            return False
        if not _is_on(meaning.side, self._bearing(number, t)):
            return False
        if meaning.metres is None:
            return True
        eye = self._eye(t)
        far = float(footprint_distances((eye.real, eye.imag), self._graph.objects[number].outline_m))
        return abs(far - meaning.metres) <= route.METRES.good * far + route.METRES_FREE

    @property
    def _half(self) -> float:
        return math.radians(self._camera.fov_deg) / 2

    def _eye(self, t: int) -> complex:
        ahead = cmath.rect(1.0, self._replay.yaw(t))
        return complex(*self._replay.position(t)) + ahead * complex(self._camera.x_m, self._camera.y_m)

    def _bearings(self, number: int, t: int) -> list[float]:
        """Returns the angles from the heading to the vertices of a footprint, radians."""
        eye, ahead = self._eye(t), cmath.rect(1.0, self._replay.yaw(t))
        return [cmath.phase((complex(*point) - eye) / ahead) for point in self._graph.objects[number].outline_m]

    def _bearing(self, number: int, t: int) -> float:
        """Returns the angle from the heading to the middle of an object as it appears in the view, radians."""
        angles = self._bearings(number, t)
        low, high = min(angles), max(angles)
        return (low + high) / 2 if high - low < math.pi else math.pi

    def _is_shown(self, number: int, t: int) -> bool:
        """Returns whether at least 40 % of the points of a footprint are in the image, with no obstacle before them."""
        return self._replay.shown_share(number, t) >= 0.4

    def _feasible_fault(self, meaning: QuestionMeaning, language: Reader) -> str:
        if meaning.instruction is None or (meaning.answer, meaning.reason) not in _EXPECTED:
            return "the answer does not belong to the question"
        x, y = self._replay.position(0)
        view = look(self._graph, (x, y, self._replay.yaw(0)), self._camera)
        verdicts = [self._expressions.evaluate(each.expression, view) for each in language.read(meaning.instruction)]
        if not verdicts:
            return "the instruction does not match the grammar"
        match meaning.reason:
            case ReasonKind.ONE_FITS:
                is_right = all(
                    not each.fault and len(each.possible) == 1 and each.sure == each.possible for each in verdicts
                )
            case ReasonKind.NONE_FITS:
                is_right = not any(each.possible or each.fault for each in verdicts)
            case _:
                is_right = all(not each.fault and len(each.sure) > 1 for each in verdicts)
        return "" if is_right else "a different number of objects fits the instruction"

    def _movement_fault(self, answer: AnswerKind, start: int, end: int) -> str:
        headings, driven = self._replay.headings(start, end), self._replay.driven(start, end)
        turned = headings[-1]
        match answer:
            case AnswerKind.TURN_LEFT:
                is_right = _TURNED_RAD <= turned < math.radians(155)
            case AnswerKind.TURN_RIGHT:
                is_right = _TURNED_RAD <= -turned < math.radians(155)
            case AnswerKind.TURN_AROUND:
                is_right = math.radians(145) <= abs(turned) <= math.radians(215)
            case AnswerKind.DOORWAY:
                return self._doorway_fault(start, end)
            case AnswerKind.STRAIGHT:
                is_right = max(headings) - min(headings) <= route.UNSAID_RAD and driven >= route.RUN_M - 0.05
            case AnswerKind.STOP:
                is_right = end == len(self._replay) and driven <= _STILL_M
            case _:
                is_right = False
        return "" if is_right else "the robot moves in another way"

    def _doorway_fault(self, start: int, end: int) -> str:
        rooms = [(t, self._replay.room(t)) for t in range(start, end) if self._replay.room(t)]
        if not rooms or rooms[0][1] == rooms[-1][1]:
            return "the robot does not change rooms"
        entered = next(t for t, room in rooms if room == rooms[-1][1])
        is_door = self._replay.passage_width(entered) <= route.DOORWAY_M.good
        return "" if is_door else "the passage is not a doorway"

    def _reason_fault(self, meaning: QuestionMeaning, start: int, end: int) -> str:
        replay, target = self._replay, self._target
        first, last = replay.gap(target, start), replay.gap(target, end - 1)
        room, target_room = replay.room(start), self._graph.objects[target].room
        turned = cmath.phase(replay.relative(target, start))
        match meaning.reason:
            case ReasonKind.REACHED:
                is_right = meaning.answer is AnswerKind.STOP and last <= route.STOP_M.good
            case ReasonKind.CLOSER:
                is_right = last <= first * (1.05 - route.TOWARDS_SHARE)
            case ReasonKind.OTHER_ROOM:
                is_right = bool(room and target_room and room != target_room)
            case ReasonKind.GOAL_AHEAD:
                is_right = abs(turned) <= limit.AHEAD_RAD.good and self._is_shown(target, start)
            case ReasonKind.GOAL_LEFT | ReasonKind.GOAL_RIGHT:
                is_right = _is_on(_TARGET_SIDE[meaning.reason], turned) and abs(turned) < math.radians(155)
            case _:
                is_right = False
        return "" if is_right else "the reason is not true"


def _is_on(side: SeenSide, bearing: float) -> bool:
    match side:
        case SeenSide.AHEAD:
            return at_most(abs(bearing), limit.AHEAD_RAD) is Truth.YES
        case SeenSide.LEFT:
            return at_least(bearing, limit.EGO_RAD) is Truth.YES
        case _:
            return at_least(-bearing, limit.EGO_RAD) is Truth.YES
