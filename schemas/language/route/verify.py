"""Decides whether the text of a route is true: reads it, replays the poses on the map, and tests every step.

Independent of the code that finds steps, except that both use the scene graph, doorways, thresholds and words.
"""

from __future__ import annotations

import cmath
import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from schemas.config import CameraConfig
from schemas.language.expression import Expression
from schemas.language.graph.scene_graph import SceneGraph
from schemas.language.graph.view import look
from schemas.language.route import thresholds as limit
from schemas.language.route.doorways import RoomPassage
from schemas.language.route.meaning import RobotSide, RouteStep, RouteText, StepKind
from schemas.language.route.reading import RouteReader
from schemas.language.route.replay import PoseReplay
from schemas.language.verifier.verify import Verifier

_NEAR_M = 2.0
"""Gap within which an object is near a step, metres."""
# the search of steps uses 3 m (`_NEAR_M` in `steps.py`), because it measures to rectangles and at other frames; the
# margin keeps it from steps that this verifier would reject


class RouteVerifier:
    """Verifier of routes in one scene.

    Args:
        graph: scene graph.
        expressions: verifier of referring expressions in the scene.
        doorways: passages between rooms.
        camera: camera of the robot.
    """

    def __init__(
        self, graph: SceneGraph, expressions: Verifier, doorways: Sequence[RoomPassage], camera: CameraConfig
    ) -> None:
        self._graph, self._expressions, self._doorways, self._camera = graph, expressions, doorways, camera

    def check(self, route: RouteText, language: RouteReader, poses: NDArray[np.float64], target: int) -> str:
        """Returns why a route is not true for a recorded path; empty if every reading of every step is true.

        Args:
            route: text and spans; the recorded meaning of the steps is not used.
            language: reader of its language.
            poses: (T, 7) recorded poses of base_link in the world frame.
            target: number of the target in the scene graph.
        """
        spans = [(each.start, each.end) for each in route.steps]
        edges = [0, *(end for _, end in spans)]
        if [start for start, _ in spans] != edges[:-1] or edges[-1] != len(poses) or any(a >= b for a, b in spans):
            return "the spans do not cover the frames"
        readings = language.read(route.text)
        if not readings:
            return "the text does not match the grammar of routes"
        for each in route.steps:
            if not language.read_step(each.text):
                return "a step does not match the grammar"
        alone = [language.read_step(each.text) for each in route.steps]
        replay = PoseReplay(self._graph, poses, self._camera)
        for steps in readings:
            if len(steps) != len(spans):
                return "the text has a different number of steps"
            if any(step not in alternatives for step, alternatives in zip(steps, alone, strict=True)):
                return "a step differs from its own sentence"
            for step, span in zip(steps, spans, strict=True):
                fault = self._fault(step, replay, *span, target)
                if fault:
                    return f"{step.kind}: {fault}"
        return ""

    def _fault(self, step: RouteStep, replay: PoseReplay, start: int, end: int, target: int) -> str:
        """Returns why one step is not true within its span."""
        is_last = end == len(replay)
        if is_last != (step.kind is StepKind.STOP):
            return "only the last step is a stop"
        fault = self._unsaid(step, replay, start, end)
        if fault:
            return fault
        match step.kind:
            case StepKind.TURN:
                return _turn_fault(step, replay.headings(start, end))
            case StepKind.FORWARD:
                assert step.metres is not None
                driven = replay.driven(start, end)
                allowed = limit.METRES.good * driven + limit.METRES_FREE
                return "" if abs(driven - step.metres) <= allowed else "the distance is wrong"
            case StepKind.CORNER:
                return (
                    _corner_fault(step, replay.headings(start, end)) or self._entered_fault(step, replay, start, end)[0]
                )
            case StepKind.DOOR:
                return self._door_fault(step, replay, start, end)
            case _:
                return self._object_fault(step, replay, start=start, end=end, target=target)

    def _unsaid(self, step: RouteStep, replay: PoseReplay, start: int, end: int) -> str:
        """Returns a fault if the span has a turn or a doorway that the step does not name; otherwise an empty text."""
        headings = replay.headings(start, end)
        if step.kind not in (StepKind.TURN, StepKind.CORNER) and max(headings) - min(headings) > limit.UNSAID_RAD:
            return "it does not name a turn"
        if len(self._crossed(replay, start, end)) > (step.kind in (StepKind.DOOR, StepKind.CORNER)):
            return "it does not name a doorway"
        return ""

    def _crossed(self, replay: PoseReplay, start: int, end: int) -> list[int]:
        """Returns the frames at which the path goes through a doorway into another room, in which it stays."""
        crossed, room = [], 0
        for t in range(start, end):
            here = replay.room(t)
            if here and room and here != room and self._stays(replay, t, here, end):
                if replay.passage_width(t) <= limit.DOORWAY_M.good:
                    crossed.append(t)
                room = here
            room = room or here
        return crossed

    def _stays(self, replay: PoseReplay, t: int, room: int, end: int) -> bool:
        driven = next((k for k in range(t, end) if replay.driven(t, k + 1) > 0.45), None)
        return driven is not None and all(replay.room(k) in (0, room) for k in range(t, driven + 1))

    def _entered_fault(self, step: RouteStep, replay: PoseReplay, start: int, end: int) -> tuple[str, int, int]:
        """Returns why the robot does not enter the room of a step (empty if it does), the room before, and the frame at
        which the robot enters."""
        rooms = [(t, replay.room(t)) for t in range(start, end) if replay.room(t)]
        # the step may start in a doorway, which is in no room: then, the previous room counts
        first = next((room for t in range(start, -1, -1) if (room := replay.room(t))), 0)
        before, after = (first or rooms[0][1], rooms[-1][1]) if rooms else (0, 0)
        if before == after:
            return "the robot does not change rooms", 0, 0
        entered = next(t for t, room in rooms if room == after)
        if replay.passage_width(entered) > limit.DOORWAY_M.good:
            return "the passage is not a doorway", 0, 0
        is_other = step.room is not None and self._graph.types[after - 1] != step.room
        return "the room has a different type" if is_other else "", before, entered

    def _door_fault(self, step: RouteStep, replay: PoseReplay, start: int, end: int) -> str:
        fault, before, entered = self._entered_fault(step, replay, start, end)
        if fault:
            return fault
        here, way = replay.position(start), replay.position(entered)
        nearer = math.dist(here, way) + limit.NEXT_DOOR_M - 0.5
        for each in self._doorways:
            if before in each.rooms and math.dist(each.middle, way) > 1.2:
                is_ahead = abs(replay.bearing(each.middle, start)) < limit.DOOR_AHEAD_RAD - 0.05
                if is_ahead and math.dist(each.middle, here) < nearer:
                    return "another doorway is ahead"
        return ""

    def _object_fault(self, step: RouteStep, replay: PoseReplay, start: int, end: int, target: int) -> str:
        """Returns why the object of `towards`, `past` or `stop` is not where the step says, or not unique."""
        assert step.named is not None
        fitting = self._fitting(step.named, replay, start, end)
        if len(fitting) != 1:
            return "no object fits the words" if not fitting else "several objects fit the words"
        (number,) = fitting
        match step.kind:
            case StepKind.PAST:
                return _pass_fault(step, replay, number=number, start=start, end=end)
            case StepKind.TOWARDS:
                first, last = replay.relative(number, start), replay.relative(number, end - 1)
                if abs(cmath.phase(first)) > limit.TOWARDS_RAD.good + 0.02:
                    return "the object is not ahead"
                if abs(cmath.phase(last)) > limit.TOWARDS_END_RAD.good + 0.02:
                    return "the robot drives past the object"
                return "" if abs(last) <= abs(first) * (1.05 - limit.TOWARDS_SHARE) else "the robot does not get closer"
            case _:
                if number != target:
                    return "it names an object other than the target"
                return "" if replay.gap(number, end - 1) <= limit.STOP_M.good else "the robot stops elsewhere"

    def _fitting(self, named: Expression, replay: PoseReplay, start: int, end: int) -> set[int]:
        """Returns the objects that the words fit: in the scene, or near the step if only kind and colour are named.

        The number -1 means: the words fit an object near the step only as a borderline case.
        """
        if named.clauses or named.size is not None or named.ordinal is not None:
            x, y = replay.position(start)
            view = look(self._graph, (x, y, replay.yaw(start)), self._camera)
            verdict = self._expressions.evaluate(named, view)
            return set() if verdict.fault or verdict.sure != verdict.possible else set(verdict.possible)
        verdict = self._expressions.evaluate(named.model_copy(update={"definite": False}), None)
        frames = [start, (2 * start + end) // 3, (start + 2 * end) // 3, end - 1]
        around = {
            number
            for number in verdict.possible
            if any(replay.gap(number, t) <= _NEAR_M or replay.may_see(number, t, limit.AMBIGUOUS_M) for t in frames)
        }
        return around if around <= verdict.sure else around | {-1}


def _turn_fault(step: RouteStep, headings: Sequence[float]) -> str:
    assert step.size is not None
    turned = headings[-1]
    least, most = limit.TURN_RAD[step.size]
    if step.side is not None and (turned > 0) != (step.side is RobotSide.LEFT):
        return "the robot turns to the other side"
    if not least <= abs(turned) <= most:
        return "the turn has a different size"
    ahead = [heading if turned > 0 else -heading for heading in headings]
    if -min(ahead) > limit.REVERSED_RAD or max(ahead) - ahead[-1] > limit.REVERSED_RAD:
        return "the robot turns to both sides"
    return ""


def _corner_fault(step: RouteStep, headings: Sequence[float]) -> str:
    turned = headings[-1] if step.side is RobotSide.LEFT else -headings[-1]
    return "" if limit.CORNER_RAD[0] <= turned <= limit.CORNER_RAD[1] else "the turn has a different side or size"


def _pass_fault(step: RouteStep, replay: PoseReplay, number: int, start: int, end: int) -> str:
    places = {t: replay.relative(number, t) for t in replay.frames(start, end)}
    if places[start].real < limit.BEFORE_M.good - 0.05:
        return "the object is not ahead at the start of the step"
    if places[end - 1].real > -limit.BEHIND_M.good + 0.05:
        return "the object is not behind at the end of the step"
    nearest = min(places, key=lambda t: replay.gap(number, t))
    if replay.gap(number, nearest) > limit.PASS_M.good + 0.1:
        return "the object is too far away"
    abeam = min(places, key=lambda t: abs(places[t].real))
    if (places[abeam].imag > 0) != (step.side is RobotSide.LEFT):
        return "the object is on the other side"
    if abs(cmath.phase(places[abeam])) < limit.ASIDE_RAD:
        return "the object is not beside the path"
    return "" if replay.may_see(number, start, 15.0) else "the object is not visible"
