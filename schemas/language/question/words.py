"""Words of questions in one language, read from `data/question_<code>.toml`; writes their sentences."""

from __future__ import annotations

import re
import tomllib
from collections.abc import Mapping
from functools import cache, cached_property
from typing import NamedTuple

import numpy as np

from schemas.base import Model, Name
from schemas.language.kinds import DATA
from schemas.language.question.meaning import (
    AnswerKind,
    Question,
    QuestionKind,
    QuestionMeaning,
    ReasonKind,
    SeenSide,
)
from schemas.language.sentence.grammar import Grammar, Patterns, alternatives

SLOT = re.compile(r"\{(np|side|metres|instruction)(?::([a-z]+))?\}")
"""Slot of a sentence, and the case of a referring expression."""
_MOST_CHARACTERS = 500


class QuestionPattern(NamedTuple):
    """Pattern of a question without alternatives."""

    template_id: str
    """Name, such as `en_where_002`."""
    kind: QuestionKind
    """Subject."""
    text: str
    """Text with slots."""
    held_out: bool
    """Whether only the split `test_paraphrase_ood` uses it."""


class QuestionWords(Model):
    """Content of `data/question_<code>.toml`."""

    code: Name
    """Code of the language."""
    metres: tuple[str, str]
    """Text for a distance of one metre, and for several metres."""
    asked_sides: dict[SeenSide, str]
    """Parts of the view in questions."""
    sides: dict[SeenSide, str]
    """Parts of the view in answers."""
    questions: dict[QuestionKind, Patterns]
    """Patterns of questions."""
    answers: dict[AnswerKind, tuple[str, ...]]
    """Answers."""
    reasons: dict[ReasonKind, tuple[str, ...]]
    """Reasons."""

    @cached_property
    def patterns(self) -> tuple[QuestionPattern, ...]:
        """Patterns of questions without alternatives, numbered within each kind."""
        patterns = []
        for kind, templates in self.questions.items():
            texts = [
                (text, held) for held, group in ((False, templates.seen), (True, templates.held_out)) for text in group
            ]
            whole = [(one, held) for text, held in texts for one in alternatives(text)]
            patterns += [
                QuestionPattern(f"{self.code}_{kind}_{number:03d}", kind, text, held)
                for number, (text, held) in enumerate(whole, 1)
            ]
        return tuple(patterns)

    def write(
        self,
        meaning: QuestionMeaning,
        span: tuple[int, int],
        held_out: bool,
        nouns: Grammar,
        rng: np.random.Generator,
    ) -> Question | None:
        """Returns a question as text, with a random pattern and random synonyms.

        Args:
            meaning: meaning of question, answer and reason.
            span: first frame, and the frame after the last one.
            held_out: whether to use the held-out patterns.
            nouns: grammar of the language.
            rng: random generator.

        Returns:
            The question; `None` if it is longer than 500 characters.
        """
        usable = [each for each in self.patterns if (each.kind, each.held_out) == (meaning.kind, held_out)]
        pattern = usable[int(rng.integers(len(usable)))]
        choice = {"kind": int(rng.integers(6)), "colour": int(rng.integers(6))}

        def said(text: str, sides: Mapping[SeenSide, str]) -> str:
            return nouns.finished(SLOT.sub(lambda slot: self._word(slot, meaning, sides, nouns, choice), text))

        def drawn(texts: tuple[str, ...]) -> str:
            return said(texts[int(rng.integers(len(texts)))], self.sides)

        question = said(pattern.text, self.asked_sides)
        if len(question) > _MOST_CHARACTERS:
            return None
        return Question(
            question=question,
            answer=drawn(self.answers[meaning.answer]),
            reason=None if meaning.reason is None else drawn(self.reasons[meaning.reason]),
            language=self.code,
            template_id=pattern.template_id,
            held_out=pattern.held_out,
            start=span[0],
            end=span[1],
            meaning=meaning,
        )

    def _word(
        self,
        slot: re.Match[str],
        meaning: QuestionMeaning,
        sides: Mapping[SeenSide, str],
        nouns: Grammar,
        choice: Mapping[str, int],
    ) -> str:
        match slot[1]:
            case "np":
                assert meaning.named is not None
                return nouns.phrase(meaning.named, slot[2] or "nom", choice)
            case "metres":
                return self.metres[meaning.metres != 1].format(n=meaning.metres)
            case "side":
                assert meaning.side is not None
                return sides[meaning.side]
            case _:
                return str(meaning.instruction)


@cache
def question_words(code: str) -> QuestionWords:
    return QuestionWords.model_validate(tomllib.loads((DATA / f"question_{code}.toml").read_text(encoding="utf-8")))
