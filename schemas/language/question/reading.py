"""Reads a question with its answer and reason back: returns every meaning. Does not use the code that writes them."""

from __future__ import annotations

import itertools
import re
from collections.abc import Iterable, Iterator, Mapping
from functools import cache
from typing import NamedTuple, TypeVar

from pydantic import ValidationError

from schemas.language.expression import Expression
from schemas.language.question.meaning import AnswerKind, QuestionKind, QuestionMeaning, ReasonKind, SeenSide
from schemas.language.question.words import SLOT, question_words
from schemas.language.sentence.grammar import alternatives
from schemas.language.sentence.reading import Reader

Kind = TypeVar("Kind", bound=str)
_QUOTED = "{instruction}"


class _Pattern(NamedTuple):
    """Pattern of a sentence as a regular expression."""

    name: str
    pattern: re.Pattern[str]
    quotes: bool
    """Whether the pattern ends with a quoted instruction. Then, the sentence is matched without being normalised."""


class QuestionReader:
    """Reader of questions in one language.

    Args:
        code: code of the language.
        language: reader of referring expressions.
    """

    def __init__(self, code: str, language: Reader) -> None:
        words = question_words(code)
        self._words, self._language = words, language
        patterns = {kind: (*group.seen, *group.held_out) for kind, group in words.questions.items()}
        self._questions = self._compiled(patterns, words.asked_sides)
        self._answers = self._compiled(words.answers, words.sides)
        self._reasons = self._compiled(words.reasons, words.sides)
        self._sides = {
            language.normal(text): side
            for sides in (words.asked_sides, words.sides)
            for side, text in sides.items()
        }  # fmt: skip

    def read(self, question: str, answer: str, reason: str | None) -> list[QuestionMeaning]:
        """Returns all readings; empty if a text matches no pattern of the language."""
        question_readings, replied = (
            list(self._parts(self._questions, question)),
            list(self._parts(self._answers, answer)),
        )
        given = [("", {})] if reason is None else list(self._parts(self._reasons, reason))
        readings: list[QuestionMeaning] = []
        for (kind, one), (reply, two), (why, three) in itertools.product(question_readings, replied, given):
            if (one.keys() & two.keys()) | (one.keys() & three.keys()) | (two.keys() & three.keys()):
                continue
            try:
                meaning = QuestionMeaning(
                    kind=QuestionKind(kind),
                    answer=AnswerKind(reply),
                    reason=ReasonKind(why) if why else None,
                    **{**one, **two, **three},  # type: ignore[arg-type]
                )
            except ValidationError:
                continue
            if meaning not in readings:
                readings.append(meaning)
        return readings

    def _parts(self, patterns: Iterable[_Pattern], sentence: str) -> Iterator[tuple[str, dict[str, object]]]:
        """Yields the name of each pattern that a sentence matches, with the meaning of its slots."""
        written = sentence.strip()
        text = self._language.normal(written)
        for each in patterns:
            match = each.pattern.fullmatch(written if each.quotes else text)
            if match is None:
                continue
            parts: dict[str, object] = {}
            named: list[Expression | None] = [None]
            for slot, value in match.groupdict().items():
                if slot == "side":
                    parts["side"] = self._sides[value]
                elif slot == "metres":
                    parts["metres"] = int(value)
                elif slot == "instruction":
                    parts["instruction"] = value
                else:
                    named = list(self._language.read_phrase(value.strip()))
            for one in named:
                yield each.name, parts if one is None else {**parts, "named": one}

    def _compiled(self, texts: Mapping[Kind, tuple[str, ...]], sides: Mapping[SeenSide, str]) -> list[_Pattern]:
        return [
            _Pattern(str(name), self._expression(one, sides), _QUOTED in one)
            for name, group in texts.items()
            for text in group
            for one in alternatives(text)
        ]

    def _expression(self, text: str, sides: Mapping[SeenSide, str]) -> re.Pattern[str]:
        if _QUOTED in text:
            return re.compile(f"{re.escape(text.removesuffix(_QUOTED))}(?P<instruction>.+)", re.IGNORECASE)
        pieces = SLOT.split(text)  # literal, slot, case, literal, ...
        parts = []
        for place in range(0, len(pieces), 3):
            parts.append(re.escape(self._language.normal(pieces[place])))
            if place + 1 < len(pieces):
                parts.append(self._group(pieces[place + 1], sides))
        return re.compile("".join(parts))

    def _group(self, slot: str, sides: Mapping[SeenSide, str]) -> str:
        if slot == "side":
            return f"(?P<side>{'|'.join(re.escape(self._language.normal(each)) for each in sides.values())})"
        if slot == "metres":
            units = [self._language.normal(each.replace("{n}", "")) for each in self._words.metres]
            ends = dict.fromkeys(map(re.escape, units))
            return f"(?P<metres>\\d{{1,2}})(?:{'|'.join(sorted(ends, key=len, reverse=True))})"
        return f"(?P<{slot}>.+)"


@cache
def question_reader(code: str, language: Reader) -> QuestionReader:
    """Returns the reader of questions in a language, which reads referring expressions with the given reader."""
    return QuestionReader(code, language)
