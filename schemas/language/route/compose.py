"""Writes verified routes: finds steps, draws register and words, and keeps what the verifier accepts."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from schemas.language.draw import draw_weighted
from schemas.language.language_file import LanguageSpec, SpokenLanguage
from schemas.language.route.meaning import DrivenPath, RouteStep, RouteText, StepKind, SubInstruction
from schemas.language.route.reading import RouteReader, route_reader
from schemas.language.route.steps import RouteSearch, SceneRoutes, SpannedStep
from schemas.language.route.verify import RouteVerifier
from schemas.language.route.words import RouteWords, route_words
from schemas.language.sentence.grammar import SentencePattern

_TRIES = 3
_MOST_CHARACTERS = 500


class _Spoken:
    """Words and reader of routes in one language."""

    def __init__(self, language: SpokenLanguage) -> None:
        self.nouns = language.grammar
        self.words: RouteWords = route_words(language.code)
        self.reader: RouteReader = route_reader(language.code, language.reader)


class RouteComposer:
    """Writer of routes according to a language file.

    Args:
        spec: content of the language file.
    """

    def __init__(self, spec: LanguageSpec) -> None:
        self._spec = spec
        self._spoken = {code: _Spoken(SpokenLanguage(spec, code)) for code, share in spec.languages.items() if share}
        self.rejected: Counter[str] = Counter()
        """Number of routes that the verifier rejected, by reason."""

    def write(
        self,
        place: SceneRoutes,
        poses: NDArray[np.float64],
        number: int,
        held_out: bool,
        rng: np.random.Generator,
    ) -> list[RouteText]:
        """Returns up to `per_episode` different routes for a recorded path; none if it has no clear description.

        Args:
            place: scene prepared for routes.
            poses: (T, 7) recorded poses of base_link in the world frame.
            number: number of the target in the scene graph.
            held_out: whether to use the held-out sentence patterns.
            rng: random generator.
        """
        path, texts = DrivenPath(poses), dict[str, RouteText]()
        verifier = RouteVerifier(place.scene.graph, place.scene.verifier, place.doorways, place.camera)
        for _ in range(_TRIES * self._spec.per_episode):
            if len(texts) == self._spec.per_episode:
                break
            spoken = self._spoken[draw_weighted(self._spec.languages, rng)]
            steps = RouteSearch(place, path, number=number, words=spoken.nouns, rng=rng).steps()
            if not steps:
                self.rejected["no clear description"] += 1
                break
            one = self._say(spoken, steps, held_out, rng)
            if one is None:
                self.rejected["too long"] += 1
                continue
            fault = verifier.check(one, spoken.reader, poses, number)
            if fault:
                self.rejected[fault] += 1
            else:
                texts.setdefault(one.text, one)
        return list(texts.values())

    def _say(
        self, spoken: _Spoken, steps: Sequence[SpannedStep], held_out: bool, rng: np.random.Generator
    ) -> RouteText | None:
        """Draws a register and words for the steps; returns `None` if the text is too long for an instruction."""
        words = spoken.words
        steps = [each._replace(step=_nameable(each, words)) for each in steps]
        shares = {name: share for name, share in self._spec.registers.items() if share > 0}
        register = draw_weighted(shares, rng)
        frames = [each for each in words.frames if (each.register, each.held_out) == (register, held_out)]
        frame: SentencePattern = frames[int(rng.integers(len(frames)))]
        clauses = [
            words.clause(each.step, frame.case, held_out=held_out, nouns=spoken.nouns, rng=rng) for each in steps
        ]
        register_words, text = words.registers[register], clauses[0]
        for place, clause in enumerate(clauses[1:], 1):
            joints = register_words.last if place == len(clauses) - 1 else register_words.joiners
            text += joints[int(rng.integers(len(joints)))] + clause
        finished = spoken.nouns.finished
        whole = finished(frame.before + text + frame.after)
        if len(whole) > _MOST_CHARACTERS:
            return None
        return RouteText(
            text=whole,
            language=words.code,
            register_name=register,
            template_id=frame.template_id,
            held_out=held_out,
            steps=tuple(
                SubInstruction(
                    number=place,
                    text=finished(clause + words.full_stop),
                    step=each.step,
                    start=each.start,
                    end=each.end,
                )
                for place, (each, clause) in enumerate(zip(steps, clauses, strict=True), 1)
            ),
        )


def _nameable(each: SpannedStep, words: RouteWords) -> RouteStep:
    """Returns the step without the type of its room if the language has no word for it."""
    step = each.step
    if step.kind is StepKind.DOOR and step.room is not None and step.room not in words.rooms:
        return step.model_copy(update={"room": None})
    return step
