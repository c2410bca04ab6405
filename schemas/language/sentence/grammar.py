"""Grammar of a language: words, relations and sentence patterns, read from `data/<code>.toml`; writes sentences.

Does not choose words or patterns, and does not read sentences.
"""

from __future__ import annotations

import itertools
import re
import tomllib
import unicodedata
from collections.abc import Iterator, Mapping, Sequence
from functools import cache, cached_property
from typing import NamedTuple

from pydantic import Field

from schemas.base import Model, Name
from schemas.errors import UsageError
from schemas.language.expression import (
    AHEAD_SIDES,
    COUNTED,
    STATES,
    Clause,
    Expression,
    Landmark,
    Ordinal,
    Relation,
    Size,
)
from schemas.language.kinds import DATA
from schemas.support.suggest import did_you_mean

LANGUAGES = ("en", "de", "es", "zh")
"""Codes of the languages (ISO 639-1)."""
REGISTERS = ("imperative", "polite", "question", "terse", "spoken")
"""Registers of the sentence patterns."""
SLOT = re.compile(r"\{(np|0|1|room|count)(?::([a-z]+))?\}")
"""Slot of a pattern: its content and its case."""
_CHOICE = re.compile(r"\(([^()]*\|[^()]*)\)")
_GENDER = re.compile(r"<([^<>]*)>")
_SPACES = re.compile(r"\s+")


class Patterns(Model):
    """Sentence patterns of a register, with alternatives."""

    seen: tuple[str, ...]
    """Patterns of every split but `test_paraphrase_ood`."""
    held_out: tuple[str, ...]
    """Patterns of the split `test_paraphrase_ood`."""


class SentencePattern(NamedTuple):
    """Sentence pattern without alternatives."""

    template_id: str
    """Name, such as `en_polite_012`."""
    register: str
    """Register of the pattern."""
    held_out: bool
    """Whether only the split `test_paraphrase_ood` uses it."""
    before: str
    """Text before the referring expression."""
    case: str
    """Case of the referring expression, or `bare` for one without article."""
    after: str
    """Text after the referring expression."""


class Grammar(Model):
    """Content of `data/<code>.toml`."""

    code: Name
    """Code of the language."""
    name: str
    """English name of the language."""
    head_last: bool
    """Whether relations precede the noun."""
    genders: tuple[str, ...]
    """Genders of nouns, in the order of `<a|b|c>`; empty for a language without gender."""
    layout: str
    """Order of the parts of a referring expression."""
    opener: str = ""
    """Text before the first of several relations."""
    joiner: str
    """Text between two relations."""
    say: tuple[tuple[str, str], ...] = ()
    """Regular expressions and their replacements, which contract the words of a sentence."""
    read: tuple[tuple[str, str], ...] = ()
    """Regular expressions and their replacements, which undo `say`."""
    articles: dict[str, tuple[str, ...]]
    """Articles; a key has the parts `the`, `a` or `landmark`, then gender and case where they matter."""
    endings: dict[str, str] = Field(default_factory=dict)
    """Endings of adjectives by article, gender and case."""
    ordinals: dict[str, str]
    """Ordinal numbers."""
    sizes: dict[Size, tuple[str, ...]]
    """Superlatives."""
    colours: dict[Name, tuple[str, ...]]
    """Colour words."""
    materials: dict[Name, tuple[str, ...]]
    """Material words; `layout` sets their position."""
    states: dict[Relation, tuple[str, ...]]
    """Adjectives that are synonyms of relations without landmarks."""
    numbers: dict[str, str]
    """Number words, for numbers of objects."""
    plurals: dict[Name, tuple[str, ...]]
    """Plural nouns by kind, in the grammatical case that relations with a number require."""
    sides: dict[str, tuple[str, ...]]
    """Sides at which counting starts."""
    relations: dict[Relation, tuple[str, ...]]
    """Relations."""
    rooms: dict[Name, tuple[str, ...]]
    """Types of rooms, with article."""
    nouns: dict[Name, tuple[str, ...]]
    """Nouns by kind, in languages with genders or measure words as `noun:gender`."""
    patterns: dict[Name, Patterns]
    """Sentence patterns by register."""
    negations: tuple[str, ...]
    """Words that a paraphrased pattern must not have."""
    actions: tuple[str, ...]
    """Words of which a paraphrased pattern must have at least one."""
    paraphrases: dict[Name, tuple[str, ...]] = Field(default_factory=dict)
    """Paraphrased patterns of a language file, by register."""

    @cached_property
    def sentences(self) -> tuple[SentencePattern, ...]:
        """All sentence patterns without alternatives, numbered within each register."""
        sentences = []
        for register, templates in self.patterns.items():
            texts = [
                (text, held_out)
                for held_out, group in ((False, templates.seen), (True, templates.held_out))
                for text in group
            ]
            whole = dict.fromkeys((one, held_out) for text, held_out in texts for one in alternatives(text))
            for number, (text, held_out) in enumerate(whole, 1):
                slot = SLOT.search(text)
                assert slot is not None, f"{text!r} has no slot"
                name = f"{self.code}_{register}_{number:03d}"
                case = slot[2] or "nom"
                sentences.append(
                    SentencePattern(
                        name,
                        register,
                        held_out=held_out,
                        before=text[: slot.start()],
                        case=case,
                        after=text[slot.end() :],
                    )
                )
        return (*sentences, *self._paraphrased())

    def _paraphrased(self) -> Iterator[SentencePattern]:
        for register, texts in self.paraphrases.items():
            for number, text in enumerate(texts, 1):
                slot = SLOT.search(text)
                assert slot is not None, f"{text!r} has no slot"
                name = f"{self.code}_paraphrase_{register}_{number:03d}"
                yield SentencePattern(
                    name,
                    register,
                    held_out=False,
                    before=text[: slot.start()],
                    case=slot[2] or "nom",
                    after=text[slot.end() :],
                )

    @cached_property
    def kinds(self) -> frozenset[str]:
        """Kinds that the language can name, and types of rooms."""
        return frozenset({*self.nouns, *(f"in {room}" for room in self.rooms)})

    def names(self, kind: str) -> bool:
        """Returns whether the language has a noun for a kind."""
        return kind in self.nouns

    def sentence(
        self, pattern: SentencePattern, expression: Expression, choice: Mapping[str, int] | None = None
    ) -> str:
        """Returns the sentence of a pattern for an expression.

        Args:
            pattern: sentence pattern.
            expression: meaning of the referring expression.
            choice: number of the synonym of each word group, see `phrase`.

        Raises:
            KeyError: the language has no word for a part of the expression.
        """
        return self.finished(pattern.before + self.phrase(expression, pattern.case, choice or {}) + pattern.after)

    def finished(self, text: str) -> str:
        """Returns a sentence with contracted words and a capital letter."""
        for wanted, given in self.say:
            text = re.sub(wanted, given, text)
        text = unicodedata.normalize("NFC", text)
        return text[0].upper() + text[1:]

    def phrase(self, expression: Expression, case: str, choice: Mapping[str, int]) -> str:
        """Returns the referring expression in a case.

        Args:
            expression: its meaning.
            case: case of the slot; `bare` omits the article.
            choice: number of the synonym by word group: `kind`, `landmark`, `relation`, `size`, `side`, `colour`,
                `article`, `material`; modulo the number of synonyms.
        """
        noun, gender = _split(_nth(self.nouns[expression.kind], choice.get("kind", 0)))
        article = "the" if expression.definite else "a"
        named = article if case != "bare" else "bare"
        parts = {
            "article": "" if case == "bare" else self._article(article, gender, case, choice.get("article", 0)),
            "ordinal": "" if expression.ordinal is None else self.ordinals[_place(expression.ordinal)],
            "size": "" if expression.size is None else _nth(self.sizes[expression.size], choice.get("size", 0)),
            "colour": ""
            if expression.colour is None
            else _nth(self.colours[expression.colour], choice.get("colour", 0)),
            "material": ""
            if expression.material is None
            else _nth(self.materials[expression.material], choice.get("material", 0)),
            "state": " ".join(filter(None, (self._adjective(clause, choice) for clause in expression.clauses))),
        }
        ending = self._ending(named, gender, "nom" if case == "bare" else case)
        words = {name: self._agreeing(text, gender).replace("~", ending) for name, text in parts.items()}
        if self.head_last and words["ordinal"]:
            words["article"] = ""
        if expression.ordinal is not None:
            words["side"] = _nth(self.sides[_side(expression)], choice.get("side", 0)).replace("~", ending)
        spoken = [clause for clause in expression.clauses if not self._adjective(clause, choice)]
        clauses = [self._clause(clause, gender, choice, number) for number, clause in enumerate(spoken)]
        # the opener "that is" cannot precede "with two chairs"
        has_with = any(clause.relation in STATES | COUNTED for clause in spoken)
        opener = self.opener if len(clauses) > 1 and not has_with else ""
        words |= {"noun": noun, "clauses": opener + self.joiner.join(clauses)}
        return _SPACES.sub(" ", _fill(self.layout, words)).strip()

    def _adjective(self, clause: Clause, choice: Mapping[str, int]) -> str:
        """Returns the adjective of a relation; empty if the words of the relation follow the noun."""
        words = self.states.get(clause.relation, ())
        number = choice.get("relation", 0) % (len(words) + len(self.relations[clause.relation]))
        return words[number] if number < len(words) else ""

    def _clause(self, clause: Clause, gender: str, choice: Mapping[str, int], number: int) -> str:
        text = _nth(self.relations[clause.relation], choice.get("relation", 0) + number)
        text = self._agreeing(text, gender)

        def fill(slot: re.Match[str]) -> str:
            if slot[1] == "room":
                assert clause.room is not None
                return _nth(self.rooms[clause.room], choice.get("landmark", 0))
            if slot[1] == "count":
                return self.numbers[str(clause.count)]
            if slot[2] == "many":
                return _nth(self.plurals[clause.landmarks[int(slot[1])].kind], choice.get("landmark", 0))
            return self._landmark(clause.landmarks[int(slot[1])], slot[2] or "nom", choice.get("landmark", 0))

        return SLOT.sub(fill, text)

    def _landmark(self, landmark: Landmark, case: str, synonym: int) -> str:
        noun, gender = _split(_nth(self.nouns[landmark.kind], synonym))
        article = "the" if landmark.definite else "landmark"
        ending = self._ending(article, gender, case)
        colour = "" if landmark.colour is None else self.colours[landmark.colour][0].replace("~", ending)
        words = {"article": self._article(article, gender, case, 0), "colour": colour, "noun": noun}
        return _SPACES.sub(" ", _fill(self.layout, words)).strip()

    def _article(self, article: str, gender: str, case: str, synonym: int) -> str:
        for key in (f"{article}_{gender}_{case}", f"{article}_{gender}", article):
            if key in self.articles:
                return _nth(self.articles[key], synonym).replace("~", gender)
        raise KeyError(article)

    def _ending(self, article: str, gender: str, case: str) -> str:
        known = (f"{article}_{gender}_{case}", f"{article}_{gender}", f"{article}_{case}", gender, article)
        return next((self.endings[key] for key in known if key in self.endings), gender if not self.genders else "")

    def _agreeing(self, text: str, gender: str) -> str:
        """Returns a text with the alternative of each `<a|b|c>` that agrees with a gender."""
        place = self.genders.index(gender) if gender in self.genders else 0
        return _GENDER.sub(lambda match: match[1].split("|")[place], text)


def _place(ordinal: Ordinal) -> str:
    """Returns the key of an ordinal in `ordinals`. The word of key `1` is empty, because "leftmost" needs no
    ordinal."""
    return "first" if ordinal.number == 1 and ordinal.side in AHEAD_SIDES else str(ordinal.number)


def _side(expression: Expression) -> str:
    ordinal = expression.ordinal
    assert ordinal is not None
    return f"{ordinal.side}most" if ordinal.number == 1 and ordinal.side not in AHEAD_SIDES else str(ordinal.side)


def _nth(words: Sequence[str], number: int) -> str:
    return words[number % len(words)]


def _split(noun: str) -> tuple[str, str]:
    word, _, gender = noun.partition(":")
    return word, gender


def _fill(layout: str, words: Mapping[str, str]) -> str:
    return re.sub(r"\{(\w+)\}", lambda slot: words.get(slot[1], ""), layout)


def alternatives(text: str) -> list[str]:
    """Returns the texts of a pattern with alternatives, in the order of the alternatives.

    >>> alternatives("(Go|Drive) to {np}(| now).")
    ['Go to {np}.', 'Go to {np} now.', 'Drive to {np}.', 'Drive to {np} now.']
    """
    parts = _CHOICE.split(text)
    options = [part.split("|") if number % 2 else [part] for number, part in enumerate(parts)]
    return ["".join(chosen) for chosen in itertools.product(*options)]


@cache
def grammar(code: str) -> Grammar:
    """Returns the grammar of a language.

    Raises:
        UsageError: unknown language.
    """
    if code not in LANGUAGES:
        raise UsageError(f"unknown language {code!r}; languages: {', '.join(LANGUAGES)}{did_you_mean(code, LANGUAGES)}")
    return Grammar.model_validate(tomllib.loads((DATA / f"{code}.toml").read_text(encoding="utf-8")))
