"""Describes a driven path in steps: turns, doorways, objects passed, and the target at the end. Writes no words."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from schemas.config import CameraConfig
from schemas.language.expression import Expression, Family
from schemas.language.generator.minimal import minimal_expressions
from schemas.language.generator.search import Search
from schemas.language.generator.view_facts import ViewFacts
from schemas.language.graph.view import SceneView, look
from schemas.language.kinds import UNKNOWN
from schemas.language.route import thresholds as limit
from schemas.language.route.doorways import RoomChange, RoomPassage, doorway_of, room_changes
from schemas.language.route.meaning import DrivenPath, RobotSide, RouteStep, StepKind, TurnSize
from schemas.language.route.segment import PathPart, divide_path
from schemas.language.scene import SceneLanguage
from schemas.language.sentence.grammar import Grammar
from schemas.support.numpy_types import Bools, Floats

_LATER = frozenset(Family) - {Family.VIEW}
"""Features that the last step of a route with several steps may use. `VIEW` is excluded, because "as seen from here"
would mean the start of the route."""
_SHORT_M = 0.8
"""Maximum length of the remainder of a straight run that gets no separate step, metres. Such a remainder joins the
previous step of the run, or the turn after the run if the run has no step."""
_BEYOND_M = 0.3
"""Distance that a step continues after a doorway or an object, metres."""
_APART_M = 2.0
"""Minimum distance that the robot drives after one named object until it has passed the next one, metres."""
_NEAR_M = 3.0
"""Gap within which an object is near a step, metres; 1 m more than in the verifier, like the distances in `_rivals`."""
_NEARER_M = (4.0, 2.5, 1.5, 0.8, 0.4, 0.2)
"""Distances before the end of the path at which the last step may begin, metres. They are tried in this order, until
a description fits only the target."""
_CUTS_RAD = (math.radians(60), math.radians(90), math.radians(120))
"""Headings at which a long turn is divided, relative to the heading at its start."""
_SMALLEST_RAD = limit.TURN_RAD[TurnSize.SLIGHT][0]
_EVERY = 6


class SpannedStep(NamedTuple):
    """Step with its frames."""

    step: RouteStep
    start: int
    end: int


@dataclass(frozen=True)
class SceneRoutes:
    """Scene prepared for routes.

    Args:
        scene: prepared scene.
        camera: camera of the robot.
    """

    scene: SceneLanguage
    camera: CameraConfig

    @property
    def doorways(self) -> tuple[RoomPassage, ...]:
        return self.scene.doorways


class RouteSearch:
    """Finds the steps of one path; draws one of several steps that are equally true.

    Args:
        place: scene of the path.
        path: driven path.
        number: number of the target in the scene graph.
        words: grammar of the language, which limits what can be named.
        rng: random generator.
    """

    def __init__(
        self, place: SceneRoutes, path: DrivenPath, number: int, words: Grammar, rng: np.random.Generator
    ) -> None:
        self._place, self._path, self._target, self._words, self._rng = place, path, number, words, rng
        self._graph, self._facts = place.scene.graph, place.scene.facts
        self._views: dict[int, SceneView] = {}

    def steps(self) -> list[SpannedStep]:
        """Returns the steps, whose spans cover the path; empty if a part of it has no clear description."""
        parts = divide_path(self._path)
        if parts[-1].turn_rad:  # the path ends with a turn, so the end of this turn becomes the stop
            parts[-1:] = self._cut(parts[-1])
        changes = room_changes(self._graph, self._path)
        steps: list[SpannedStep] = []
        first = 0
        for number, part in enumerate(parts):
            changes_inside = [change for change in changes if part.start <= change.frame < part.end]
            if part.turn_rad:
                # the step also covers the frames after the step before it, whose heading may differ a little
                turned = float(self._path.yaw[part.end - 1] - self._path.yaw[first])
                if abs(turned) < _SMALLEST_RAD and not changes_inside:
                    continue
                turns = self._turned(first, part.end, changes_inside)
                if not turns:
                    return []
                steps += turns
            else:
                is_last = number == len(parts) - 1
                run = self._run(part._replace(start=first), changes_inside, is_last)
                if run is None:
                    return []
                steps += run
            first = steps[-1].end if steps else 0
        return steps

    def _turned(self, start: int, end: int, changes: list[RoomChange]) -> list[SpannedStep]:
        """Returns the steps of a turn, perhaps with a doorway; empty if it has no clear description."""
        doors = [each for each in changes if doorway_of(self._place.doorways, each, self._path.xy[each.frame])]
        turned = float(self._path.yaw[end - 1] - self._path.yaw[start])
        if not doors:
            return self._turn(start, end)
        if len(doors) > 1:
            return []
        if abs(turned) >= limit.CORNER_RAD[1]:
            return self._divided(start, end, doors[0])
        return self._through(start, end, doors[0])

    def _turn(self, start: int, end: int) -> list[SpannedStep]:
        turned = float(self._path.yaw[end - 1] - self._path.yaw[start])
        size, side = turn_size(turned), RobotSide.LEFT if turned > 0 else RobotSide.RIGHT
        if size is None:
            return []
        step = RouteStep(kind=StepKind.TURN, size=size, side=None if size is TurnSize.AROUND else side)
        return [SpannedStep(step, start, end)]

    def _through(self, start: int, end: int, change: RoomChange) -> list[SpannedStep]:
        """Returns the step of a turn in a doorway, or of a drive through a doorway with hardly any turn; empty if
        the step has no clear description."""
        turned = float(self._path.yaw[end - 1] - self._path.yaw[start])
        kind, side = self._graph.types[change.after - 1], RobotSide.LEFT if turned > 0 else RobotSide.RIGHT
        if abs(turned) >= limit.CORNER_RAD[1]:
            return []
        if abs(turned) >= limit.CORNER_RAD[0]:
            return [SpannedStep(RouteStep(kind=StepKind.CORNER, side=side, room=kind), start, end)]
        doorway = doorway_of(self._place.doorways, change, self._path.xy[change.frame])
        if doorway is None or not self._is_clear(doorway, start):
            return []
        return [SpannedStep(RouteStep(kind=StepKind.DOOR, room=kind), start, end)]

    def _divided(self, start: int, end: int, change: RoomChange) -> list[SpannedStep]:
        """Returns a long turn in two steps: one through the doorway, and one before or after it."""
        left = np.abs(self._path.yaw - self._path.yaw[start])
        after = self._frame_at(float(self._path.along[change.frame]) + _BEYOND_M + 0.2)
        for cut in (after, *(start + int(np.searchsorted(left[start:end], share)) for share in _CUTS_RAD)):
            if change.frame + 1 < cut < end:
                door, turn = self._through(start, cut, change), self._turn(cut, end)
            elif start < cut <= change.frame:
                door, turn = self._turn(start, cut), self._through(cut, end, change)
            else:
                continue
            if door and turn:
                return [*door, *turn]
        return []

    def _cut(self, part: PathPart) -> list[PathPart]:
        """Divides the last turn into two parts: until the final heading is reached, and the rest."""
        left = np.abs(self._path.yaw[part.start : part.end] - self._path.yaw[part.end - 1])
        settled = part.start + int(np.flatnonzero(left > math.radians(4))[-1]) + 1
        settled = min(settled, part.end - 1)
        return [part._replace(end=settled), PathPart(settled, part.end, 0.0)]

    def _run(self, part: PathPart, changes: list[RoomChange], is_last: bool) -> list[SpannedStep] | None:
        """Returns the steps of a straight run; `None` if one of them has no clear description."""
        run_steps: list[SpannedStep] = []
        first = part.start
        for change in changes:
            doorway = doorway_of(self._place.doorways, change, self._path.xy[change.frame])
            if doorway is None:
                continue
            run_steps += self._passes(first, change.frame)
            first = run_steps[-1].end if run_steps else first
            if not self._is_clear(doorway, first):
                return None
            done = min(self._frame_at(self._path.along[change.frame] + _BEYOND_M), part.end - int(is_last))
            kind = self._graph.types[change.after - 1]
            run_steps.append(SpannedStep(RouteStep(kind=StepKind.DOOR, room=kind), first, max(done, change.frame + 1)))
            first = run_steps[-1].end
        run_steps += self._passes(first, part.end)
        first = run_steps[-1].end if run_steps else first
        left = float(self._path.along[part.end - 1] - self._path.along[min(first, part.end - 1)])
        if is_last:
            last = self._arrival(min(first, part.end - 1), part.end, left)
            return [*run_steps, *last] if last else None
        if left > _SHORT_M:
            return [*run_steps, self._onward(first, part.end, left)]
        if run_steps:
            run_steps[-1] = run_steps[-1]._replace(end=part.end)
        return run_steps

    def _frame_at(self, along_m: float) -> int:
        return int(np.searchsorted(self._path.along, along_m)) + 1

    def _view(self, t: int) -> SceneView:
        if t not in self._views:
            self._views[t] = look(self._graph, self._path.pose(t), self._place.camera)
        return self._views[t]

    def _is_clear(self, doorway: RoomPassage, start: int) -> bool:
        """Returns whether a doorway is ahead at the start of a step, and no other doorway of the room makes the step
        ambiguous."""
        x, y, yaw = self._path.pose(start)
        (room,) = {self._graph.room_at(x, y)} & doorway.rooms or {0}

        def offset(each: RoomPassage) -> tuple[float, float]:
            dx, dy = each.middle[0] - x, each.middle[1] - y
            return math.hypot(dx, dy), abs(math.remainder(math.atan2(dy, dx) - yaw, math.tau))

        side, angle = offset(doorway)
        rivals = [offset(each) for each in self._place.doorways if room in each.rooms and each != doorway]
        ahead = [far for far, aside in rivals if aside < limit.DOOR_AHEAD_RAD]
        return angle < math.pi / 3 and all(far > side + limit.NEXT_DOOR_M for far in ahead)

    def _passes(self, start: int, end: int) -> list[SpannedStep]:
        """Returns steps past objects between two frames; objects too soon after the previous one are omitted."""
        if end - start < 2 or self._path.along[end - 1] - self._path.along[start] < limit.RUN_M:
            return []
        passes: list[SpannedStep] = []
        for done, side, number in self._passed(start, end):
            first = passes[-1].end if passes else start
            if passes and self._path.along[done - 1] - self._path.along[first] < _APART_M:
                continue
            named = self._named(number, first, done)
            if named is not None and self._view(first).sure[number] and self._is_before(number, first):
                passes.append(SpannedStep(RouteStep(kind=StepKind.PAST, side=side, named=named), first, done))
        return passes

    def _is_before(self, number: int, t: int) -> bool:
        ahead, _ = self._offsets(np.array([t]))
        return bool(ahead[0, number] >= limit.BEFORE_M.good)

    def _offsets(self, frames: NDArray[np.integer[Any]]) -> tuple[Floats, Floats]:
        """Returns (K, N) distances of the middles of objects ahead and to the left of the robot at K frames, metres."""
        offset = self._facts.centre[None] - self._path.xy[frames][:, None]
        cos, sin = np.cos(self._path.yaw[frames])[:, None], np.sin(self._path.yaw[frames])[:, None]
        return offset[..., 0] * cos + offset[..., 1] * sin, offset[..., 1] * cos - offset[..., 0] * sin

    def _gaps(self, frames: NDArray[np.integer[Any]]) -> Floats:
        """Returns (K, N) gaps between the robot's centre and the objects' bounding rectangles, metres."""
        points = self._path.xy[frames][:, None]
        beyond = np.maximum(self._graph.low[None, :, :2] - points, points - self._graph.high[None, :, :2])
        return np.asarray(np.hypot(*np.moveaxis(beyond.clip(0.0), -1, 0)))

    def _passed(self, start: int, end: int) -> Iterator[tuple[int, RobotSide, int]]:
        """Yields for each passed object, in the order of passing: the frame after which it is behind the robot, its
        side, and its number."""
        frames = np.arange(start, end, _EVERY)
        ahead, left = self._offsets(frames)
        gaps = self._gaps(frames)
        nearest = gaps.argmin(axis=0)
        columns = np.arange(gaps.shape[1])
        behind = (ahead[-1] < -limit.BEHIND_M.good - 0.1) & (ahead[0] > limit.BEFORE_M.good)
        close = gaps[nearest, columns] <= limit.PASS_M.good
        aside = (np.sign(left) == np.sign(left[nearest, columns])).all(axis=0)
        room_numbers = self._graph.room_of
        rooms = {self._graph.room_at(*self._path.xy[t].tolist()) for t in (start, end - 1)}
        same = (room_numbers == 0) | np.isin(room_numbers, list(rooms))
        passed = np.flatnonzero(behind & close & aside & same)
        done = [frames[int(np.argmax(ahead[:, each] < -limit.BEHIND_M.good - 0.1))] for each in passed]
        for place in np.argsort(done, kind="stable").tolist():
            number = int(passed[place])
            if number != self._target and min(int(done[place]) + _EVERY, end) > start:
                side = RobotSide.LEFT if left[nearest[number], number] > 0 else RobotSide.RIGHT
                yield min(int(done[place]) + _EVERY, end), side, number

    def _named(self, number: int, start: int, end: int) -> Expression | None:
        """Returns the shortest description of an object that fits no other object near the step, or `None`."""
        each = self._graph.objects[number]
        if not self._words.names(each.kind):
            return None
        has_colour = each.colour != UNKNOWN and self._graph.kinds.of(each.kind).plain
        rivals = self._rivals(start, end)
        for colour in (None, each.colour) if has_colour else (None,):
            possible = self._facts.described(each.kind, colour).possible & rivals
            if not (possible & (np.arange(len(possible)) != number)).any():
                return Expression(kind=each.kind, colour=colour)
        return None

    def _rivals(self, start: int, end: int) -> Bools:
        """Returns which of the N objects may be seen from the step, or are near it."""
        frames = np.unique(np.append(np.arange(start, end, _EVERY * 5), end - 1))
        views = [self._view(t) for t in {start, (start + end) // 2, end - 1}]
        seen = [view.possible & (view.distance <= limit.AMBIGUOUS_M + 1.0) for view in views]
        return np.asarray(np.logical_or.reduce([(self._gaps(frames) <= _NEAR_M).any(axis=0), *seen]))

    def _onward(self, start: int, end: int, length_m: float) -> SpannedStep:
        """Returns a step that goes straight on, either towards an object ahead or for a distance."""
        view = self._view(start)
        ahead = np.abs(view.bearing) <= limit.TOWARDS_RAD.good
        nearer = np.hypot(*(self._facts.centre - self._path.xy[end - 1]).T) <= view.distance * (1 - limit.TOWARDS_SHARE)
        before, left = self._offsets(np.array([end - 1]))
        straight = np.abs(np.arctan2(left[0], before[0])) <= limit.TOWARDS_END_RAD.good
        fitting = np.flatnonzero(view.sure & ahead & nearer & straight).tolist()
        for number in self._rng.permutation(fitting).tolist() if self._rng.random() < 0.7 else ():
            named = self._named(int(number), start, end)
            if named is not None:
                return SpannedStep(RouteStep(kind=StepKind.TOWARDS, named=named), start, end)
        return SpannedStep(RouteStep(kind=StepKind.FORWARD, metres=max(1, round(length_m))), start, end)

    def _arrival(self, start: int, end: int, left_m: float) -> list[SpannedStep]:
        """Returns the last step; or a step that goes straight on, and a last step that begins nearer to the target.

        Several places are tried in order; the last step begins at the first one from which a description fits only the
        target. Without such a place, the result is empty.
        """
        stop = self._stop(start, end)
        if stop is not None:
            return [stop]
        for rest_m in _NEARER_M:
            place = self._frame_at(float(self._path.along[end - 1]) - rest_m)
            if left_m - rest_m < limit.RUN_M or not start < place < end:
                continue
            stop = self._stop(place, end)
            if stop is not None:
                return [self._onward(start, place, left_m - rest_m), stop]
        return []

    def _stop(self, start: int, end: int) -> SpannedStep | None:
        """Returns the last step; `None` if no words fit only the target."""
        named = self._named(self._target, start, end)
        if named is None:
            seen = ViewFacts(self._facts, self._view(start))
            families, words = _LATER if start else frozenset(Family), self._words.model_copy(update={"rooms": {}})
            search = Search(self._place.scene.parts, seen, number=self._target, families=families, words=words)
            fitting = minimal_expressions(search, self._rng)
            if not fitting:
                return None
            named = fitting[int(self._rng.integers(len(fitting)))]
        return SpannedStep(RouteStep(kind=StepKind.STOP, named=named), start, end)


def turn_size(turned_rad: float) -> TurnSize | None:
    """Returns the size of a turn; `None` for more than a turn around, or less than a slight one."""
    for size, (least, most) in limit.TURN_RAD.items():
        if least <= abs(turned_rad) < most:
            return size
    return None
