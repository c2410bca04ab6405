"""Finds the movements of a driven path, and why each one leads to the target. Writes no words."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np

from schemas.language import thresholds as near
from schemas.language.graph.view import look
from schemas.language.question.meaning import AnswerKind, QuestionKind, QuestionMeaning, ReasonKind
from schemas.language.route import thresholds as limit
from schemas.language.route.doorways import doorway_of, room_changes
from schemas.language.route.meaning import DrivenPath, TurnSize
from schemas.language.route.segment import divide_path
from schemas.language.route.steps import SceneRoutes

_BEFORE_DOOR_M = 2.0
"""Distance before a doorway at which the movement through the doorway begins, metres."""
_CLEAR_RAD = math.radians(30)
"""Smallest change of heading of a movement that is called a turn."""
_DONE_M = 0.1
"""Distance before the end of the path at which the stop begins, metres."""


def movements(place: SceneRoutes, path: DrivenPath, number: int) -> list[tuple[QuestionMeaning, tuple[int, int]]]:
    """Returns the movements of a path with their reasons and frames; movements whose reason is uncertain are omitted.

    Args:
        place: scene prepared for routes.
        path: driven path.
        number: number of the target in the scene graph.
    """
    found_movements = []
    for answer, start, end in _movements(place, path):
        reason = _reason(place, path, number=number, answer=answer, start=start, end=end)
        if reason is not None and end > start:
            found_movements.append(
                (QuestionMeaning(kind=QuestionKind.NEXT, answer=answer, reason=reason), (start, end))
            )
    return found_movements


def _movements(place: SceneRoutes, path: DrivenPath) -> Iterator[tuple[AnswerKind, int, int]]:
    changes = room_changes(place.scene.graph, path)
    for part in divide_path(path):
        turned = abs(part.turn_rad)
        doors = [each for each in changes if part.start <= each.frame < part.end]
        if turned:
            is_around = limit.TURN_RAD[TurnSize.AROUND][0] <= turned < limit.TURN_RAD[TurnSize.AROUND][1]
            side = AnswerKind.TURN_LEFT if part.turn_rad > 0 else AnswerKind.TURN_RIGHT
            if turned >= _CLEAR_RAD and not doors:
                yield AnswerKind.TURN_AROUND if is_around else side, part.start, part.end
            continue
        if not doors:
            yield AnswerKind.STRAIGHT, part.start, part.end
        for each in doors:
            if doorway_of(place.doorways, each, path.xy[each.frame]) is not None:
                first = int(np.searchsorted(path.along, path.along[each.frame] - _BEFORE_DOOR_M))
                yield AnswerKind.DOORWAY, max(first, part.start), each.frame + 1
    yield AnswerKind.STOP, int(np.searchsorted(path.along, path.along[-1] - _DONE_M)), len(path)


def _reason(
    place: SceneRoutes, path: DrivenPath, number: int, answer: AnswerKind, start: int, end: int
) -> ReasonKind | None:
    graph, facts = place.scene.graph, place.scene.facts
    view = look(graph, path.pose(start), place.camera)
    target = graph.objects[number].room
    is_other = bool(target and view.room and target != view.room)
    offset = facts.centre[number] - path.xy[start]
    bearing = math.remainder(math.atan2(offset[1], offset[0]) - path.yaw[start], math.tau)
    gap = [float(np.hypot(*_beyond(place, number, path, t))) for t in (start, end - 1)]
    match answer:
        case AnswerKind.STOP:
            return ReasonKind.REACHED if gap[1] <= limit.STOP_M.good - 0.05 else None
        case AnswerKind.DOORWAY:
            return ReasonKind.OTHER_ROOM if is_other else None
        case AnswerKind.STRAIGHT:
            if path.along[end - 1] - path.along[start] < limit.RUN_M:
                return None
            if view.sure[number] and abs(bearing) <= near.AHEAD_RAD.good - 0.02:
                return ReasonKind.GOAL_AHEAD
            if gap[1] <= gap[0] * (0.95 - limit.TOWARDS_SHARE):
                return ReasonKind.CLOSER
            return ReasonKind.OTHER_ROOM if is_other else None
        case _:
            side = ReasonKind.GOAL_LEFT if bearing > 0 else ReasonKind.GOAL_RIGHT
            wanted = {AnswerKind.TURN_LEFT: ReasonKind.GOAL_LEFT, AnswerKind.TURN_RIGHT: ReasonKind.GOAL_RIGHT}
            if _CLEAR_RAD <= abs(bearing) <= math.radians(150) and wanted.get(answer) is side:
                return side
            return ReasonKind.OTHER_ROOM if is_other else None


def _beyond(place: SceneRoutes, number: int, path: DrivenPath, t: int) -> tuple[float, float]:
    """Returns the gaps along x and y between the robot and the bounding rectangle of an object, metres."""
    low, high, point = (place.scene.graph.low[number], place.scene.graph.high[number], path.xy[t])
    x, y = np.maximum(0, np.maximum(low[:2] - point, point - high[:2])).tolist()
    return x, y
