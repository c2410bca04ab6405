"""Writes questions about a recorded episode: draws kinds and frames, computes answers and reasons from the scene graph.

Keeps what the verifier accepts. Opens no file; the random generator is an argument.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from schemas.language import thresholds as limit
from schemas.language.compose import Composer
from schemas.language.draw import draw_weighted
from schemas.language.expression import Expression
from schemas.language.generator.view_facts import ViewFacts
from schemas.language.graph.view import SceneView, look
from schemas.language.instruction import Instruction
from schemas.language.kinds import UNKNOWN
from schemas.language.language_file import SpokenLanguage
from schemas.language.question.meaning import (
    AnswerKind,
    Question,
    QuestionKind,
    QuestionMeaning,
    ReasonKind,
    SeenSide,
)
from schemas.language.question.movements import movements
from schemas.language.question.verify import FrameImages, QuestionVerifier
from schemas.language.question.words import question_words
from schemas.language.route.meaning import DrivenPath
from schemas.language.route.steps import SceneRoutes
from schemas.support.numpy_types import Floats, Ints
from schemas.terms import CATEGORIES

_TRIES = 4
_MOVING_SHARE = 0.75
"""Share of the questions about the next movement whose answer is drawn from the movements other than the stop."""
_METRES_SHARE, _METRES_FREE = 0.2, 0.1
"""A distance is rounded to whole metres only if this changes it by at most `_METRES_SHARE` of the distance plus
`_METRES_FREE` metres."""


class AskedEpisode(NamedTuple):
    """Episode that questions are about."""

    poses: Floats
    """(T, 7) recorded poses of base_link in the world frame."""
    number: int
    """Number of the target in the scene graph."""
    goals: tuple[Instruction, ...] = ()
    """Its verified instructions that name the target."""
    is_false_premise: bool = False
    """Whether the robot stays at its start because the object that its instruction names does not exist."""
    images: FrameImages | None = None
    """Recorded instance ids and depth; `None` for an episode without images."""


_Answer = tuple[QuestionMeaning, tuple[int, int]]


class QuestionComposer:
    """Writer of questions according to a language file.

    Args:
        composer: writer of instructions of the language file.
    """

    def __init__(self, composer: Composer) -> None:
        self._composer, self._spec = composer, composer.spec
        self._spoken = {code: SpokenLanguage(self._spec, code) for code, share in self._spec.languages.items() if share}
        self.rejected: Counter[str] = Counter()
        """Number of questions that the verifier rejected, by reason."""

    def write(
        self, place: SceneRoutes, episode: AskedEpisode, held_out: bool, rng: np.random.Generator
    ) -> list[Question]:
        """Returns at most one question of each kind.

        Args:
            place: scene prepared for routes.
            episode: the episode.
            held_out: whether to use the held-out sentence patterns.
            rng: random generator.
        """
        verifier = QuestionVerifier(place, episode.poses, episode.number)
        # answers come from the scene graph and the poses, because recordings of states have no images
        search, questions = _Answers(place, episode, self._composer, rng), []
        for kind in QuestionKind:
            if kind in (QuestionKind.WHERE, QuestionKind.NEXT) and episode.is_false_premise:
                continue
            for _ in range(_TRIES):
                is_quoted = kind is QuestionKind.FEASIBLE and bool(episode.goals)
                code = episode.goals[0].language if is_quoted else draw_weighted(self._spec.languages, rng)
                answer = search.of(kind, self._spoken[code], held_out)
                one = answer and question_words(code).write(*answer, held_out, self._spoken[code].grammar, rng)
                if not one:
                    continue
                fault = verifier.check(one, self._spoken[code].reader, episode.images)
                if not fault:
                    questions.append(one)
                    break
                self.rejected[f"{kind}: {fault}"] += 1
        return questions


class _Answers:
    """Computes answers about one episode; draws frame and object at random."""

    def __init__(self, place: SceneRoutes, episode: AskedEpisode, composer: Composer, rng: np.random.Generator) -> None:
        self._place, self._scene, self._episode, self._composer, self._rng = place, place.scene, episode, composer, rng
        self._graph, self._facts = place.scene.graph, place.scene.facts
        self._path = DrivenPath(episode.poses)
        self._seen: tuple[SceneView, Floats] | None = None

    def of(self, kind: QuestionKind, language: SpokenLanguage, held_out: bool) -> _Answer | None:
        """Returns the meaning of a question with its frames; `None` if the drawn question has no sure answer."""
        if kind is QuestionKind.FEASIBLE:
            return self._feasible(language, held_out)
        if kind is QuestionKind.NEXT:
            return self._movement()
        t = int(self._rng.integers(len(self._path)))
        view = look(self._graph, self._path.pose(t), self._place.camera)
        distance = ViewFacts(self._facts, view).distance
        match kind:
            case QuestionKind.VISIBLE:
                answer = self._visible(view, distance, language)
            case QuestionKind.OBJECT:
                answer = self._object(view, language)
            case _:
                answer = self._where(view, distance)
        return None if answer is None else (answer, (t, t + 1))

    def _movement(self) -> _Answer | None:
        candidates = movements(self._place, self._path, self._episode.number)
        others = [each for each in candidates if each[0].answer is not AnswerKind.STOP]
        options = others if others and self._rng.random() < _MOVING_SHARE else candidates
        return options[int(self._rng.integers(len(options)))] if options else None

    def _named(self, number: int) -> Expression:
        """Returns the kind of an object as an indefinite expression, perhaps with its colour."""
        each = self._graph.objects[number]
        is_plain = each.colour != UNKNOWN and self._graph.kinds.of(each.kind).plain
        colour = each.colour if is_plain and self._rng.random() < 0.5 else None
        return Expression(kind=each.kind, colour=colour, definite=False)

    def _visible(self, view: SceneView, distance: Floats, language: SpokenLanguage) -> QuestionMeaning | None:
        if self._rng.random() < 0.5:
            seen = self._nameable(view, language)
            if not len(seen):
                return None
            named = self._named(int(self._rng.choice(seen)))
            fitting = self._facts.described(named.kind, named.colour).sure & view.sure
            # perhaps the drawn object is only a borderline case of its kind, such as a chair that looks like a stool
            if not fitting.any():
                return None
            nearest = min(np.flatnonzero(fitting).tolist(), key=lambda each: float(distance[each]))
            side, metres = side_of(float(view.bearing[nearest])), rounded(float(distance[nearest]))
            if side is None or metres is None:
                return None
            return QuestionMeaning(
                kind=QuestionKind.VISIBLE, answer=AnswerKind.YES, reason=ReasonKind.SEEN_AT, named=named, side=side,
                metres=metres,
            )  # fmt: skip
        unseen = list(self._unseen(view, language))
        if not unseen:
            return None
        named, reason = unseen[int(self._rng.integers(len(unseen)))]
        return QuestionMeaning(kind=QuestionKind.VISIBLE, answer=AnswerKind.NO, reason=reason, named=named)

    def _nameable(self, view: SceneView, language: SpokenLanguage) -> Ints:
        """Returns the surely visible objects that a language can name."""
        seen = np.flatnonzero(view.sure)
        return np.array([n for n in seen.tolist() if language.grammar.names(self._graph.objects[n].kind)], np.int64)

    def _unseen(self, view: SceneView, language: SpokenLanguage) -> Iterator[tuple[Expression, ReasonKind]]:
        """Yields kinds, with and without colour, of which surely no object is visible, each with the reason."""
        held = {(each.kind, each.colour) for each in self._graph.objects}
        named: dict[tuple[str, str | None], None] = dict.fromkeys((kind, None) for kind in CATEGORIES)
        named |= dict.fromkeys((kind, None) for kind, _ in sorted(held))
        plain = [each for each in sorted(held) if each[1] != UNKNOWN and self._graph.kinds.of(each[0]).plain]
        named |= dict.fromkeys(plain)
        for kind, colour in named:
            masks = self._facts.described(kind, colour)
            if not language.grammar.names(kind) or (masks.possible & view.possible).any():
                continue
            expression = Expression(kind=kind, colour=colour, definite=False)
            if not masks.possible.any():
                yield expression, ReasonKind.NONE_EXISTS
            elif masks.sure.any():
                yield expression, ReasonKind.NOT_IN_VIEW

    def _object(self, view: SceneView, language: SpokenLanguage) -> QuestionMeaning | None:
        seen = [n for n in self._nameable(view, language).tolist() if side_of(float(view.bearing[n]))]
        if not seen:
            return None
        number = int(self._rng.choice(seen))
        side, named = side_of(float(view.bearing[number])), self._named(number)
        return QuestionMeaning(kind=QuestionKind.OBJECT, answer=AnswerKind.OBJECT, named=named, side=side)

    def _where(self, view: SceneView, distance: Floats) -> QuestionMeaning | None:
        number = self._episode.number
        if view.sure[number]:
            side, metres = side_of(float(view.bearing[number])), rounded(float(distance[number]))
            if side is None or metres is None:
                return None
            return QuestionMeaning(kind=QuestionKind.WHERE, answer=AnswerKind.THERE, side=side, metres=metres)
        if view.possible[number]:
            return None
        room, half = self._graph.objects[number].room, math.radians(self._place.camera.fov_deg) / 2
        reason = ReasonKind.HIDDEN
        if room and view.room and room != view.room:
            reason = ReasonKind.OTHER_ROOM
        elif abs(view.bearing[number]) > half + limit.EDGE_RAD:
            reason = ReasonKind.OUTSIDE
        return QuestionMeaning(kind=QuestionKind.WHERE, answer=AnswerKind.UNSEEN, reason=reason)

    def _feasible(self, language: SpokenLanguage, held_out: bool) -> _Answer | None:
        """Returns a question that asks whether an instruction can be followed from the start of the episode. The
        instruction is drawn so that it fits one object, none or several."""
        draw, view = self._rng.random(), look(self._graph, self._path.pose(0), self._place.camera)
        scene, number = self._scene, self._episode.number
        text, answer, reason = None, AnswerKind.NO, ReasonKind.NONE_FITS
        if draw < 0.4:
            instructions = [
                each.meant for each in self._episode.goals if each.fits == 1 and each.language == language.code
            ]
            text = instructions[0] if instructions else None
            answer, reason = AnswerKind.YES, ReasonKind.ONE_FITS
        elif draw < 0.7:
            wrong = self._composer.write_false_premise(
                scene, view, number=number, held_out=held_out, rng=self._rng, code=language.code
            )
            text = None if wrong is None else wrong.text
        else:
            text, reason = self._several(number, language, held_out), ReasonKind.SEVERAL_FIT
        if text is None:
            return None
        meaning = QuestionMeaning(kind=QuestionKind.FEASIBLE, answer=answer, reason=reason, instruction=text)
        return meaning, (0, 1)

    def _several(self, number: int, language: SpokenLanguage, held_out: bool) -> str | None:
        """Returns an instruction whose words fit the target and other objects alike."""
        named = self._named(number).model_copy(update={"definite": True})
        if self._facts.described(named.kind, named.colour).sure.sum() < 2:
            return None
        return self._composer.say(language.code, held_out, named, self._rng)[1]


def side_of(bearing_rad: float) -> SeenSide | None:
    """Returns the part of the view that contains a bearing; `None` for a bearing between two parts."""
    if abs(bearing_rad) <= limit.AHEAD_RAD.good:
        return SeenSide.AHEAD
    if abs(bearing_rad) < limit.EGO_RAD.good:
        return None
    return SeenSide.LEFT if bearing_rad > 0 else SeenSide.RIGHT


def rounded(distance_m: float) -> int | None:
    """Returns a distance in whole metres; `None` if rounding changes it too much."""
    metres = max(1, round(distance_m))
    return metres if abs(metres - distance_m) <= _METRES_SHARE * distance_m + _METRES_FREE else None
