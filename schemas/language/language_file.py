"""Language file: shares of languages, registers and features of new instructions. Chooses no words.

Errors name the key of every mistake.
"""

from __future__ import annotations

import math
import unicodedata
from collections.abc import Iterable, Mapping
from enum import StrEnum
from pathlib import Path
from typing import Annotated, Literal, Self

from pydantic import BeforeValidator, Field, ValidationError, field_validator, model_validator

from schemas.base import Count, Fraction, Line, Model, Name, NonNegative
from schemas.errors import InvalidLanguage, UsageError
from schemas.language.expression import Family
from schemas.language.sentence.grammar import LANGUAGES, REGISTERS, Grammar, grammar
from schemas.language.sentence.mistakes import MistakeKind
from schemas.language.sentence.paraphrase import pattern_fault
from schemas.language.sentence.reading import Reader, reader
from schemas.support.foreign import path_trouble
from schemas.support.suggest import did_you_mean
from schemas.support.toml_file import mistakes_of, read_toml

LED_STARTS = 6
"""Number of starts of an episode that are rejected because the sentence lacks the feature that its weight selected."""


def _equal_shares(given: object) -> object:
    """Returns weights of 1 for a list of names, and anything else unchanged."""
    is_list = isinstance(given, list) and all(isinstance(name, str) for name in given)
    return dict.fromkeys(given, 1.0) if is_list else given  # type: ignore[call-overload]


Weights = Annotated[dict[Name, NonNegative], Field(max_length=64)]
Shares = Annotated[Weights, BeforeValidator(_equal_shares)]
"""Weights by name; a list of names gives equal shares."""


Words = Annotated[tuple[Line, ...], Field(max_length=64)]
"""Nouns of a kind."""
Nouns = Annotated[dict[Name, Words], Field(max_length=1000)]
"""Nouns by kind."""


Paraphrases = Annotated[
    dict[Name, Annotated[dict[Name, Annotated[tuple[Line, ...], Field(max_length=256)]], Field(max_length=8)]],
    Field(max_length=8),
]
"""Sentence patterns by language and register."""
LargestShares = Annotated[dict[Family, Fraction], Field(max_length=len(Family))]
"""Largest share of sentences by feature."""
Mistakes = Annotated[dict[MistakeKind, Fraction], Field(max_length=len(MistakeKind))]
"""Share of sentences by kind of error."""


_WITHOUT_VIEW = frozenset(
    {
        *(Family.COLOUR, Family.MATERIAL, Family.SUPERCLASS, Family.SIZE, Family.SUPPORT, Family.WALL),
        *(Family.STATE, Family.COUNT),
    }
)


class TextKind(StrEnum):
    """Kind of text that a relabelling writes."""

    GOAL = "goal"  # instructions that name the target
    ROUTE = "route"  # instructions that describe the driven path, with sub-instructions


class LanguageSpec(Model):
    """Content of a language file; every key is optional."""

    languages: Shares = Field(default_factory=lambda: {"en": 1.0})
    """Share of each language: en, de, es, zh."""
    registers: Shares = Field(default_factory=lambda: dict.fromkeys(REGISTERS, 1.0))
    """Share of each register: imperative, polite, question, terse, spoken."""
    features: Weights = Field(default_factory=dict)
    """Weight of each feature, which leads a sentence in proportion to it where the start permits; 1 if it is not
    listed, and 0 excludes it."""
    kinds: Annotated[tuple[TextKind, ...], Field(min_length=1, max_length=len(TextKind))] = (TextKind.GOAL,)
    """Kinds of text: `goal`, `route`."""
    per_episode: Annotated[int, Field(ge=1, le=16)] = 1
    """Number of instructions for each episode."""
    redundant: Fraction = 0.0
    """Share of expressions with one redundant part."""
    mistakes: Mistakes = Field(default_factory=dict, exclude_if=lambda it: not it)
    """Share of sentences with a typing or a speech error, by kind of error; omitted if empty."""
    fit: Literal["one", "any"] = "one"
    """`one`: an instruction fits the target only. `any`: it says "a" and fits the target and other objects."""
    same_category: Count = 0
    """Smallest number of other objects of the target's category in the scene."""
    in_view: Count = 0
    """Smallest number of other objects of the category in view with the target at the start; 0 sets no condition."""
    balanced: bool = False
    """Whether starts in a plan are selected so that the target is the nearest, and the most central, object of its
    category in view only as often as by chance; needs `in_view`."""
    exchangeable: bool = Field(default=False, exclude_if=lambda it: not it)
    """Whether a plan draws the target of an episode when the episode starts, from the objects of its category that
    could be the target from the start pose; `in_view` counts these objects. Omitted if false."""
    largest_shares: LargestShares = Field(default_factory=dict, exclude_if=lambda it: not it)
    """Largest share of the episodes of a plan or a relabelled dataset whose sentences may have a feature, by feature;
    omitted if empty."""
    questions: bool = Field(default=False, exclude_if=lambda it: not it)
    """Whether each episode gets questions with computed answers; omitted if false."""
    false_premises: Fraction = 0.0
    """Share of episodes with one more instruction, which names an object that does not exist."""
    seed: Count = 0
    """Random seed."""
    paraphrases: Paraphrases = Field(default_factory=dict, exclude_if=lambda it: not it)
    """Additional sentence patterns by language and register, each with one slot `{np}`; omitted if there are none."""
    nouns: Annotated[dict[Name, Nouns], Field(max_length=64)] = Field(default_factory=dict)
    """Nouns by language and kind, which replace or extend the built-in nouns. They are written as `noun:gender` in
    German and Spanish, and as `noun:measure word` in Chinese."""

    @field_validator("languages")
    @classmethod
    def _languages_exist(cls, given: Weights) -> Weights:
        return _known(given, LANGUAGES, "language")

    @field_validator("registers")
    @classmethod
    def _registers_exist(cls, given: Weights) -> Weights:
        return _known(given, REGISTERS, "register")

    @field_validator("features")
    @classmethod
    def _features_exist(cls, given: Weights) -> Weights:
        _known(given, tuple(Family), "feature", least=False)
        return given

    @field_validator("paraphrases")
    @classmethod
    def _paraphrases_are_patterns(cls, given: Mapping[str, Mapping[str, tuple[str, ...]]]) -> Mapping[str, object]:
        _known(dict.fromkeys(given, 1.0), LANGUAGES, "language", least=False)
        for code, group in given.items():
            _known(dict.fromkeys(group, 1.0), REGISTERS, "register", least=False)
            for text in (text for paraphrase in group.values() for text in paraphrase):
                fault = pattern_fault(code, text)
                if fault:
                    raise ValueError(f"{text!r} is not a sentence pattern: {fault}")
        return given

    @field_validator("nouns")
    @classmethod
    def _nouns_are_words(cls, given: Mapping[str, Mapping[str, tuple[str, ...]]]) -> Mapping[str, object]:
        _known(dict.fromkeys(given, 1.0), LANGUAGES, "language", least=False)
        for code, nouns in given.items():
            for kind, words in nouns.items():
                _require_words(grammar(code), kind, words)
        return given

    @model_validator(mode="after")
    def _is_possible(self) -> LanguageSpec:
        if self.balanced and not self.in_view:
            raise ValueError("`balanced` compares objects in view: set `in_view` to 1 or more")
        if self.exchangeable and (self.balanced or not self.in_view):
            raise ValueError(
                "`exchangeable` draws the target from the objects in view: set `in_view` to 1 or more, and remove "
                "`balanced`, which selects starts for a given target"
            )
        if sum(self.mistakes.values()) > 1:
            raise ValueError("the shares of `mistakes` add up to more than 1")
        if self.fit == "any" and self.redundant:
            raise ValueError("`redundant` is for instructions that fit one object; set it to 0, or set `fit` to 'one'")
        return self

    def without(self, families: Iterable[Family]) -> Self:
        """Returns the spec without some features and without `largest_shares`."""
        return self.model_copy(
            update={"features": {**self.features, **dict.fromkeys(families, 0.0)}, "largest_shares": {}}
        )

    def of_episode(self, index: int) -> Self:
        """Returns the spec of one episode of a plan, without the features that its share does not permit.

        Of the first n episodes, at most n times the share (plus one, except for the first feature) have the feature.

        Args:
            index: number of the episode, from 1.
        """
        if not self.largest_shares:
            return self
        phases = {family: place / len(self.largest_shares) for place, family in enumerate(self.largest_shares)}
        return self.without(
            family
            for family, share in self.largest_shares.items()
            if math.floor(index * share + phases[family]) == math.floor((index - 1) * share + phases[family])
        )

    @property
    def least_others(self) -> int:
        """Smallest number of other objects of the target's category in the scene."""
        return max(self.same_category, self.in_view)

    @property
    def needs_view(self) -> bool:
        """Whether expressions may depend on the start pose."""
        return bool(self.families - _WITHOUT_VIEW)

    @property
    def feature_shares(self) -> dict[str, float]:
        """Weight of each feature that is not excluded, as a share of all weights."""
        weights = {str(each): self.features.get(each, 1.0) for each in Family if each in self.families}
        return {name: weight / sum(weights.values()) for name, weight in weights.items()}

    @property
    def is_weighted(self) -> bool:
        """Whether the features that are not excluded have different weights."""
        return len({self.features.get(each, 1.0) for each in self.families}) > 1

    @property
    def families(self) -> frozenset[Family]:
        return frozenset(family for family in Family if self.features.get(family, 1.0) > 0)


def _known(given: Weights, names: tuple[str, ...], noun: str, least: bool = True) -> Weights:
    for name in given:
        if name not in names:
            raise ValueError(f"unknown {noun} {name!r}; valid: {', '.join(names)}{did_you_mean(name, names)}")
    if least and not any(given.values()):
        raise ValueError(f"at least one {noun} needs a share above 0")
    return given


def _require_words(source: Grammar, kind: str, words: tuple[str, ...]) -> None:
    taken = {noun.partition(":")[0].lower(): name for name, group in source.nouns.items() for noun in group}
    if not words:
        raise ValueError(f"{source.code}.{kind} has no noun")
    for whole in words:
        noun, _, mark = whole.partition(":")
        if not noun.strip() or any(unicodedata.category(character).startswith("C") for character in noun):
            raise ValueError(f"{source.code}.{kind}: {whole!r} is empty or has characters that are not text")
        if source.genders and mark not in source.genders:
            raise ValueError(
                f"{source.code}.{kind}: {whole!r} needs a gender, one of {', '.join(source.genders)}: NOUN:GENDER"
            )
        if taken.get(noun.lower(), kind) != kind:
            raise ValueError(f"{source.code}.{kind}: {noun!r} is already a noun of the kind {taken[noun.lower()]!r}")


class SpokenLanguage:
    """Grammar and reader of one language with the nouns of a language file.

    Args:
        spec: content of the language file.
        code: code of the language.
    """

    def __init__(self, spec: LanguageSpec, code: str) -> None:
        nouns, more = spec.nouns.get(code, {}), spec.paraphrases.get(code, {})
        base = grammar(code)
        self.code = code
        if not nouns and not more:
            self.grammar, self.reader = base, reader(code)
            return
        changes = {"nouns": {**base.nouns, **nouns}, "paraphrases": more}
        self.grammar = Grammar(**{**{name: getattr(base, name) for name in Grammar.model_fields}, **changes})
        self.reader = Reader(self.grammar)


def load_language(reference: str) -> LanguageSpec:
    """Reads a language file.

    Raises:
        UsageError: the file does not exist.
        InvalidLanguage: the file has mistakes; the error lists all of them.
    """
    trouble = path_trouble(reference)
    if trouble:
        raise UsageError(f"cannot read the language file {reference[:80]!r}: {trouble}")
    path = Path(reference)
    if not path.is_file():
        what = "that is a directory; give a TOML file" if path.is_dir() else "no such file"
        raise UsageError(f"no language file {reference!r}: {what}; docs/language.md describes its keys")
    try:
        return LanguageSpec.model_validate(read_toml(path, "language file", InvalidLanguage))
    except ValidationError as error:
        raise InvalidLanguage(f"{path} is not a valid language file", mistakes_of(error)) from error
