"""Reads a sentence back: returns every meaning that a grammar gives it. Does not use the code that writes sentences.

Reading uses the words of `data/<code>.toml`. It accepts wrong endings, because they do not change a meaning.
"""

from __future__ import annotations

import re
import unicodedata
from collections import defaultdict
from collections.abc import Iterable, Iterator, Mapping
from functools import cache, cached_property
from typing import NamedTuple

from pydantic import ValidationError

from schemas.language.expression import AHEAD_SIDES, Clause, Expression, Landmark, Ordinal, Relation, Size, ViewSide
from schemas.language.sentence.grammar import SLOT, Grammar, SentencePattern, grammar

_SPACE = re.compile(r"\s+")
_WORD = re.compile(r"[^\W\d_]+")
_GENDERED = re.compile(r"<([^<>]*)>")


class Reading(NamedTuple):
    """One reading of a sentence."""

    pattern: SentencePattern
    """Sentence pattern."""
    expression: Expression
    """Meaning of the referring expression."""


class _Words:
    """Words of one group, such as the colours, with their meanings. A longer word is found before a shorter one."""

    def __init__(self, meanings: Mapping[str, object], spaced: bool) -> None:
        self.meanings = meanings
        spellings = "|".join(map(re.escape, sorted(meanings, key=len, reverse=True)))
        end = r"(?!\w)" if spaced else ""
        self._pattern = re.compile(f"(?:{spellings}){end}" if spellings else r"(?!)")

    def match(self, text: str, at: int) -> tuple[object, int] | None:
        """Returns the meaning of the longest word at a position, and the position after the word."""
        match = self._pattern.match(text, at)
        return None if match is None else (self.meanings[match[0]], match.end())


class _Noun(NamedTuple):
    """Article, adjectives, noun and side of a referring expression, without its relations."""

    parts: Mapping[str, object]
    end: int


class Reader:
    """Reader of one language.

    Args:
        source: grammar of the language.
    """

    def __init__(self, source: Grammar) -> None:
        self._grammar = source
        self._undo = [(re.compile(replaced), read) for replaced, read in source.read]
        self._spaced = " " in source.layout
        marks = {noun.partition(":")[2] for words in source.nouns.values() for noun in words} - {*source.genders, ""}
        self._marks = (*sorted({*source.endings.values(), *marks}), "")
        self._patterns: dict[str, list[tuple[str, SentencePattern]]] = defaultdict(list)
        for pattern in source.sentences:
            self._patterns[self.normal(pattern.before)].append((self.normal(pattern.after), pattern))
        self._groups = self._tables(source)
        self._relations = list(self._clause_patterns(source))
        self._by_start: dict[str, list[tuple[Relation, tuple[str, ...]]]] = defaultdict(list)
        for relation, parts in self._relations:
            self._by_start[parts[0][:1] if parts[0] not in _SLOTS else ""].append((relation, parts))
        self._opener, self._joiner = self.normal(source.opener).strip(), self.normal(source.joiner).strip()

    @cached_property
    def vocabulary(self) -> frozenset[str]:
        """Words of the grammar in lower case, in all forms."""
        tables = [word for table in self._groups.values() for word in table.meanings]
        relations = [part for _, parts in self._relations for part in parts]
        patterns = [text for before, ends in self._patterns.items() for text in (before, *(end for end, _ in ends))]
        return frozenset(_WORD.findall(" ".join([*tables, *relations, *patterns])))

    def normal(self, text: str) -> str:
        """Returns a text in lower case, composed (NFC), with single spaces and without contractions."""
        normal = _SPACE.sub(" ", unicodedata.normalize("NFC", text)).lower()
        for pattern, replacement in self._undo:
            normal = pattern.sub(replacement, normal)
        return normal

    def read(self, sentence: str) -> list[Reading]:
        """Returns all readings of a sentence; empty if the sentence does not match the grammar."""
        text = self.normal(sentence.strip())
        readings = []
        for end in range(len(text)):
            for after, pattern in self._patterns.get(text[:end], ()):
                if text.endswith(after) and end < len(text) - len(after):
                    phrase = text[end : len(text) - len(after)]
                    readings += [Reading(pattern, expression) for expression in self.read_phrase(phrase)]
        return readings

    def read_phrase(self, phrase: str) -> list[Expression]:
        """Returns all meanings of a referring expression in normal form."""
        expressions: list[Expression] = []
        ways = self._head_last(phrase) if self._grammar.head_last else self._head_first(phrase)
        for noun, clauses in ways:
            expression = _expression(noun, clauses)
            if expression is not None and expression not in expressions:
                expressions.append(expression)
        return expressions

    def _head_first(self, phrase: str) -> Iterator[tuple[_Noun, tuple[Clause, ...]]]:
        noun = self._noun(phrase, 0)
        if noun is not None:
            start = self._skip(phrase, noun.end, self._opener)
            for clauses, end in [((), noun.end), *self._clauses(phrase, start)]:
                if end == len(phrase):
                    yield noun, clauses

    def _head_last(self, phrase: str) -> Iterator[tuple[_Noun, tuple[Clause, ...]]]:
        for clauses, end in [((), 0), *self._clauses(phrase, 0)]:
            noun = self._noun(phrase, end)
            if noun is not None and noun.end == len(phrase):
                yield noun, clauses

    def _clauses(self, text: str, at: int) -> list[tuple[tuple[Clause, ...], int]]:
        """Returns the lists of relations that begin at a position, each with the position after it."""
        clauses: list[tuple[tuple[Clause, ...], int]] = []
        for clause, end in self._clause(text, at):
            clauses.append(((clause,), end))
            after = self._skip(text, end, self._joiner)
            if after > end:
                clauses += [((clause, *rest), last) for rest, last in self._clauses(text, after)]
        return clauses

    def _clause(self, text: str, at: int) -> Iterator[tuple[Clause, int]]:
        start = self._blank(text, at)
        for relation, parts in (*self._by_start.get(text[start : start + 1], ()), *self._by_start.get("", ())):
            landmarks: list[Landmark] = []
            room: str | None = None
            count: int | None = None
            end: int | None = at
            for part in parts:
                assert end is not None
                end = self._blank(text, end)
                if part == "room":
                    named = self._groups["room"].match(text, end)
                    room, end = (None, None) if named is None else (str(named[0]), named[1])
                elif part == "count":
                    number = self._groups["number"].match(text, end)
                    count, end = (None, None) if number is None else (int(str(number[0])), number[1])
                elif part == "many":
                    several = self._groups["plural"].match(text, end)
                    landmarks += [] if several is None else [Landmark(kind=str(several[0]), definite=False)]
                    end = None if several is None else several[1]
                elif part in ("0", "1"):
                    noun = self._noun(text, end)
                    landmark = None if noun is None else _landmark(noun)
                    end = None if noun is None or landmark is None else noun.end
                    landmarks += [] if landmark is None else [landmark]
                else:
                    end = end + len(part) if text.startswith(part, end) else None
                if end is None:
                    break
            if end is not None and (end == len(text) or not self._spaced or not text[end].isalnum()):
                yield Clause(relation=relation, landmarks=tuple(landmarks), room=room, count=count), end

    def _noun(self, text: str, at: int) -> _Noun | None:
        """Returns article, adjectives, noun and side at a position."""
        parts: dict[str, object] = {}
        end = at
        while True:
            end = self._blank(text, end)
            noun = next(
                (
                    (group, match)
                    for group in _GROUPS
                    if group not in parts and (match := self._groups[group].match(text, end)) is not None
                ),
                None,
            )
            if noun is None:
                break
            group, (meaning, after) = noun
            parts[group], end, last = meaning, after, after
        if "noun" not in parts:
            return None
        return _Noun(parts, self._blank(text, last) if not self._spaced else last)

    def _blank(self, text: str, at: int) -> int:
        while at < len(text) and text[at] == " ":
            at += 1
        return at

    def _skip(self, text: str, at: int, word: str) -> int:
        start = self._blank(text, at)
        return start + len(word) if word and text.startswith(word, start) else at

    def _tables(self, source: Grammar) -> dict[str, _Words]:
        tables: dict[str, dict[str, object]] = {group: {} for group in (*_GROUPS, "room", "number", "plural")}
        for key, words in source.articles.items():
            self._add(tables["article"], words, key.partition("_")[0] == "the")
        for number, word in source.ordinals.items():
            self._add(tables["ordinal"], [word], 1 if number == "first" else int(number))
        for number, word in source.numbers.items():
            self._add(tables["number"], [word], int(number))
        groups = (
            *(("size", source.sizes), ("colour", source.colours), ("side", source.sides), ("room", source.rooms)),
            *(("material", source.materials), ("state", source.states), ("plural", source.plurals)),
        )
        for group, entries in groups:
            for name, words in entries.items():
                self._add(tables[group], words, name)
        for kind, nouns in source.nouns.items():
            self._add(tables["noun"], [noun.partition(":")[0] for noun in nouns], kind)
        return {group: _Words(words, self._spaced) for group, words in tables.items()}

    def _add(self, table: dict[str, object], words: Iterable[str], meaning: object) -> None:
        for word in filter(None, words):
            for form in _forms(word):
                for mark in self._marks if "~" in form else ("",):
                    table.setdefault(self.normal(form.replace("~", mark)), meaning)

    def _clause_patterns(self, source: Grammar) -> Iterator[tuple[Relation, tuple[str, ...]]]:
        for relation, texts in source.relations.items():
            for text in texts:
                for whole in _forms(text):
                    pieces = SLOT.split(whole)  # literal, slot, case, literal, ...
                    for place in range(2, len(pieces), 3):  # plural nouns are another slot, with a separate table
                        pieces[place - 1] = "many" if pieces[place] == "many" else pieces[place - 1]
                    parts = [piece for number, piece in enumerate(pieces) if number % 3 != 2]
                    yield relation, tuple(self.normal(part).strip() for part in parts if part.strip())


def _forms(text: str) -> list[str]:
    """Returns a text with each alternative of `<a|b|c>`."""
    match = _GENDERED.search(text)
    return [_GENDERED.sub(chosen, text) for chosen in match[1].split("|")] if match else [text]


_SLOTS = frozenset({"0", "1", "room", "count", "many"})
"""Parts of a relation that are not literal."""
_GROUPS = ("article", "ordinal", "size", "state", "colour", "material", "noun", "side")


def _landmark(noun: _Noun) -> Landmark | None:
    if noun.parts.keys() - {"article", "colour", "noun"}:
        return None
    colour = noun.parts.get("colour")
    definite = bool(noun.parts.get("article", True))
    return Landmark(kind=str(noun.parts["noun"]), colour=None if colour is None else str(colour), definite=definite)


def _expression(noun: _Noun, clauses: tuple[Clause, ...]) -> Expression | None:
    """Returns the meaning of the parts, or `None` if they contradict each other."""
    parts = noun.parts
    number, side = parts.get("ordinal"), parts.get("side")
    is_extreme = side in ("leftmost", "rightmost")
    if (number is not None or is_extreme) != (side is not None) or (number is not None and is_extreme):
        return None
    if number == 1 and side not in AHEAD_SIDES:
        return None
    ordinal = None
    if side is not None:
        ordinal = Ordinal(number=1 if is_extreme else int(str(number)), side=ViewSide(str(side).removesuffix("most")))
    colour, size, material, state = (parts.get(name) for name in ("colour", "size", "material", "state"))
    if state is not None:
        clauses = (Clause(relation=Relation(str(state))), *clauses)
    try:
        return Expression(
            kind=str(parts["noun"]),
            definite=bool(parts.get("article", True)),
            colour=None if colour is None else str(colour),
            material=None if material is None else str(material),
            size=None if size is None else Size(str(size)),
            ordinal=ordinal,
            clauses=clauses,
        )
    except ValidationError:
        return None


@cache
def reader(code: str) -> Reader:
    """Returns the reader of a language.

    Raises:
        UsageError: unknown language.
    """
    return Reader(grammar(code))
