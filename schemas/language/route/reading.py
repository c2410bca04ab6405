"""Reads the text of a route back: returns every meaning of its steps. Does not use the code that writes routes."""

from __future__ import annotations

import itertools
import re
from functools import cache
from typing import NamedTuple

from pydantic import ValidationError

from schemas.language.route.meaning import RobotSide, RouteStep, StepKind, TurnSize
from schemas.language.route.words import SLOT, RouteWords, route_words
from schemas.language.sentence.grammar import SentencePattern
from schemas.language.sentence.reading import Reader

_NUMBER = r"(?P<metres>\d{1,2})"
_MOST_READINGS = 16


class _Clause(NamedTuple):
    """Pattern of a step as a regular expression."""

    clause: str
    pattern: re.Pattern[str]


class RouteReader:
    """Reader of routes in one language.

    Args:
        words: words of routes.
        language: reader of referring expressions.
    """

    def __init__(self, words: RouteWords, language: Reader) -> None:
        self._words, self._language = words, language
        self._sides = {
            "turn": {language.normal(each): side for side, group in words.turn_words.items() for each in group},
            "pass": {language.normal(each): side for side, group in words.pass_words.items() for each in group},
        }
        self._rooms = {language.normal(each): room for room, group in words.rooms.items() for each in group}
        self._clauses = {
            form: [_Clause(each.clause, self._compiled(each.text)) for each in patterns]
            for form, patterns in words.patterns.items()
        }
        self._joints = {
            name: self._joint(register_words.joiners, register_words.last)
            for name, register_words in words.registers.items()
        }

    def read(self, text: str) -> list[tuple[RouteStep, ...]]:
        """Returns all readings of the text of a route; empty if the text does not match the grammar."""
        whole = self._language.normal(text.strip())
        readings: dict[tuple[RouteStep, ...], None] = {}
        for frame in self._words.frames:
            before, after = self._language.normal(frame.before), self._language.normal(frame.after)
            if whole.startswith(before) and whole.endswith(after) and len(whole) > len(before) + len(after):
                readings |= dict.fromkeys(self._steps(whole[len(before) : len(whole) - len(after)], frame))
        return list(readings)

    def read_step(self, text: str) -> list[RouteStep]:
        whole = self._language.normal(text.strip()).removesuffix(self._words.full_stop)
        return list(dict.fromkeys(step for form in self._clauses for step in self._clause(whole, form)))

    def _steps(self, text: str, frame: SentencePattern) -> list[tuple[RouteStep, ...]]:
        options = [self._clause(part, frame.case) for part in self._joints[frame.register].split(text)]
        return list(itertools.islice(itertools.product(*options), _MOST_READINGS))

    def _clause(self, text: str, form: str) -> list[RouteStep]:
        clause_steps = []
        for each in self._clauses[form]:
            match = each.pattern.fullmatch(text)
            if match is not None:
                clause_steps += self._meanings(each.clause, match.groupdict())
        return clause_steps

    def _meanings(self, clause: str, parts: dict[str, str]) -> list[RouteStep]:
        kind, _, size = clause.partition("_")
        side: RobotSide | None = next(
            (self._sides[slot][parts[slot]] for slot in ("turn", "pass") if slot in parts), None
        )
        named = self._language.read_phrase(parts["np"].strip()) if "np" in parts else [None]
        meanings = []
        for one in named:
            try:
                meanings.append(
                    RouteStep(
                        kind=StepKind(kind),
                        side=side,
                        size=TurnSize(size) if kind == StepKind.TURN else None,
                        named=one,
                        room=self._rooms[parts["room"]] if "room" in parts else None,
                        metres=int(parts["metres"]) if "metres" in parts else None,
                    )
                )
            except ValidationError:
                continue
        return meanings

    def _compiled(self, text: str) -> re.Pattern[str]:
        pieces = SLOT.split(text)  # literal, slot, case, literal, ...
        parts = []
        for place in range(0, len(pieces), 3):
            parts.append(re.escape(self._language.normal(pieces[place])))
            if place + 1 < len(pieces):
                parts.append(self._group(pieces[place + 1]))
        return re.compile("".join(parts))

    def _group(self, slot: str) -> str:
        if slot == "np":
            return "(?P<np>.+)"
        if slot == "metres":
            options = [self._language.normal(each.replace("{n}", "\x00")) for each in self._words.metres]
            forms = dict.fromkeys(re.escape(each.partition("\x00")[2]) for each in options)
            return f"{_NUMBER}(?:{'|'.join(sorted(forms, key=len, reverse=True))})"
        known = self._rooms if slot == "room" else self._sides[slot]
        return f"(?P<{slot}>{'|'.join(map(re.escape, sorted(known, key=len, reverse=True)))})"

    def _joint(self, joiners: tuple[str, ...], last: tuple[str, ...]) -> re.Pattern[str]:
        texts = sorted({self._language.normal(each) for each in (*joiners, *last)}, key=len, reverse=True)
        return re.compile("|".join(map(re.escape, texts)))


@cache
def _reader(code: str) -> RouteReader:
    from schemas.language.sentence.reading import reader

    return RouteReader(route_words(code), reader(code))


def route_reader(code: str, language: Reader | None = None) -> RouteReader:
    """Returns the reader of routes in a language.

    Args:
        code: code of the language.
        language: reader of referring expressions; by default, the reader with the built-in nouns.
    """
    return _reader(code) if language is None else RouteReader(route_words(code), language)
