"""Writes verified instructions for one target: draws expressions, patterns and words; keeps what the verifier accepts.

Also finds out whether a language file yields instructions in a scene. Opens no file; the random generator is an
argument.
"""

from __future__ import annotations

import functools
from collections import defaultdict
from collections.abc import Iterator, Mapping, Sequence
from typing import NamedTuple

import numpy as np

from schemas.language.draw import draw_index, draw_weighted
from schemas.language.expression import Clause, Expression, Family, Landmark, Relation
from schemas.language.generator.minimal import (
    indefinite_candidates,
    minimal_candidates,
    redundant_expressions,
)
from schemas.language.generator.search import ExpressionCandidate, Search
from schemas.language.generator.view_facts import ViewFacts
from schemas.language.graph.view import SceneView
from schemas.language.instruction import Instruction, InstructionKind
from schemas.language.kinds import UNKNOWN
from schemas.language.language_file import LanguageSpec, SpokenLanguage
from schemas.language.scene import SceneLanguage
from schemas.language.sentence.grammar import SentencePattern
from schemas.language.sentence.mistakes import MistakeKind, with_mistake
from schemas.language.sentence.reading import Reader
from schemas.terms import CATEGORIES, COLOUR_NAMES

_TRIES = 8
_FEW, _SHORT_SEARCHES = 4, 2
"""`_FEW`: number of features of a short search. `_SHORT_SEARCHES`: number of short searches before the searches with
all features."""
_WORD_GROUPS = ("kind", "landmark", "relation", "size", "side", "colour", "article", "material")
_SYNONYMS = 6


class _Options(NamedTuple):
    """Expressions for a target, grouped by their features, and the search that found them."""

    search: Search
    groups: Mapping[frozenset[Family], list[ExpressionCandidate]]


class Composer:
    """Writer of instructions according to a language file.

    Args:
        spec: content of the language file.
    """

    def __init__(self, spec: LanguageSpec) -> None:
        self.spec = spec
        self._by_language = {code: SpokenLanguage(spec, code) for code, share in spec.languages.items() if share > 0}
        self._patterns: dict[tuple[str, bool], dict[str, list[SentencePattern]]] = defaultdict(
            lambda: defaultdict(list)
        )
        for code, language in self._by_language.items():
            for pattern in language.grammar.sentences:
                if spec.registers.get(pattern.register, 0.0) > 0:
                    self._patterns[code, pattern.held_out][pattern.register].append(pattern)

    def missing_nouns(self, kinds: Sequence[str]) -> list[str]:
        """Returns a message for each kind that has no noun in a language."""
        return [
            f"{language.grammar.name} has no noun for {kind!r}; add it to [nouns.{code}] of the language file"
            for code, language in self._by_language.items()
            for kind in sorted(set(kinds))
            if not language.grammar.names(kind)
        ]

    def reader(self, code: str) -> Reader:
        return self._by_language[code].reader

    def patterns_of(self, code: str, held_out: bool) -> frozenset[str]:
        """Returns the names of the sentence patterns of a language; empty if the file does not use the language."""
        groups = self._patterns.get((code, held_out), {})
        return frozenset(pattern.template_id for group in groups.values() for pattern in group)

    def _search(
        self, scene: SceneLanguage, seen: ViewFacts | None, number: int, code: str, families: frozenset[Family]
    ) -> Search:
        return Search(scene.parts, seen, number=number, families=families, words=self._by_language[code].grammar)

    def _ranked_families(self, turn: int, rng: np.random.Generator) -> list[Family]:
        """Returns the features for try number `turn`.

        If the features have different weights, all of them, each drawn by its weight from those that are left.
        Otherwise a few that are drawn in the first two tries, and all in later tries, in an order without effect.
        """
        left = {each: self.spec.features.get(each, 1.0) for each in Family if each in self.spec.families}
        if not self.spec.is_weighted and (len(left) <= _FEW or turn >= _SHORT_SEARCHES):
            return list(left)
        drawn: dict[Family, None] = {}
        while self.spec.is_weighted and left:
            drawn[draw_weighted(left, rng)] = None
            left = {each: weight for each, weight in left.items() if each not in drawn}
        while not self.spec.is_weighted and len(drawn) < _FEW:
            drawn[draw_weighted(left, rng)] = None
        return list(drawn)

    def offers(
        self, scene: SceneLanguage, view: SceneView | None, number: int, rng: np.random.Generator
    ) -> set[frozenset[Family]]:
        """Returns the sets of features with which a target can be described; does not verify a sentence."""
        seen = None if view is None else ViewFacts(scene.facts, view)
        searches = [self._search(scene, seen, number, code, self.spec.families) for code in self._by_language]
        return {group for search in searches for group in self._grouped(search, number, rng)}

    def leading_feature(self, rng: np.random.Generator) -> Family | None:
        """Returns the feature for which a start is searched; `write` prefers it with the same random generator.

        `None` if its weight is not above the mean; many starts permit some feature of little weight.
        """
        if not self.spec.is_weighted:
            return None
        draw_weighted(self.spec.languages, rng)
        leading, shares = self._ranked_families(0, rng)[0], self.spec.feature_shares
        return leading if shares[leading] * len(shares) > 1 else None

    def write(
        self, scene: SceneLanguage, view: SceneView | None, number: int, held_out: bool, rng: np.random.Generator
    ) -> list[Instruction]:
        """Returns up to `per_episode` different instructions for a target, and perhaps one with a false premise.

        Args:
            scene: prepared scene.
            view: view at the start, or `None`.
            number: number of the target in the scene graph.
            held_out: whether to use the held-out sentence patterns.
            rng: random generator.
        """
        if scene.distractors(number) < self.spec.least_others:
            return []
        instructions: dict[str, Instruction] = {}
        seen = None if view is None else ViewFacts(scene.facts, view)
        options: dict[tuple[str, frozenset[Family]], _Options] = {}
        for turn in range(_TRIES + self.spec.per_episode):
            if len(instructions) == self.spec.per_episode:
                break
            code, ranked = draw_weighted(self.spec.languages, rng), self._ranked_families(turn, rng)
            families = frozenset(ranked)
            if (code, families) not in options:
                search = self._search(scene, seen, number, code, families)
                options[code, families] = _Options(search, self._grouped(search, number, rng))
            if all(self._is_hopeless(each, options) for each in self._by_language):
                break
            one = self._one(scene, view, number, held_out, code, options[code, families], ranked, rng)
            if one is not None:
                instructions.setdefault(one.text, one)
        if rng.random() < self.spec.false_premises:
            wrong = self.write_false_premise(scene, view, number=number, held_out=held_out, rng=rng)
            instructions |= {} if wrong is None else {wrong.text: wrong}
        return list(instructions.values())

    def _is_hopeless(self, code: str, options: Mapping[tuple[str, frozenset[Family]], _Options]) -> bool:
        """Returns whether a search with all features has found nothing in a language."""
        option = options.get((code, self.spec.families))
        return option is not None and not option.groups

    def _grouped(
        self, search: Search, number: int, rng: np.random.Generator
    ) -> dict[frozenset[Family], list[ExpressionCandidate]]:
        is_one = self.spec.fit == "one"
        kind = search.facts.graph.objects[number].kind
        groups: dict[frozenset[Family], list[ExpressionCandidate]] = defaultdict(list)
        for candidate in minimal_candidates(search, rng) if is_one else indefinite_candidates(search):
            groups[candidate.families(kind)].append(candidate)
        return groups

    def _one(
        self,
        scene: SceneLanguage,
        view: SceneView | None,
        number: int,
        held_out: bool,
        code: str,
        options: _Options,
        ranked: Sequence[Family],
        rng: np.random.Generator,
    ) -> Instruction | None:
        """Returns one instruction, or `None` if no expression exists or the verifier rejects the drawn sentence."""
        groups = options.groups
        if not groups:
            return None
        kind = scene.graph.objects[number].kind
        names = sorted(groups, key=sorted)
        if self.spec.is_weighted:
            names = _led_by_first(names, ranked)
        group = groups[names[draw_index([1.0] * len(names), rng)]]
        expression = group[int(rng.integers(len(group)))].expression(self.spec.fit == "one")
        is_minimal = True
        if self.spec.redundant and rng.random() < self.spec.redundant:
            longer = redundant_expressions(options.search, expression)
            if longer:
                expression, is_minimal = longer[int(rng.integers(len(longer)))], False
        pattern, text = self.say(code, held_out, expression, rng)
        fault = scene.verifier.check(text, self._by_language[code].reader, view, number)
        if fault:
            scene.rejected[fault] += 1
            return None
        fits = 1 if expression.definite else len(scene.verifier.evaluate(expression, view).possible)
        return self._instruction(
            InstructionKind.GOAL,
            text,
            code=code,
            pattern=pattern,
            expression=expression,
            features=features_of(expression, kind),
            is_minimal=is_minimal,
            fits=fits,
            distractors=scene.distractors(number),
            rng=rng,
        )

    def say(
        self, code: str, held_out: bool, expression: Expression, rng: np.random.Generator
    ) -> tuple[SentencePattern, str]:
        """Draws a pattern and words, and returns the pattern and the sentence.

        Args:
            code: code of the language.
            held_out: whether to use the held-out sentence patterns.
            expression: meaning of the referring expression.
            rng: random generator.
        """
        registers = self._patterns[code, held_out]
        shares = {name: self.spec.registers[name] for name in registers}
        patterns = registers[draw_weighted(shares, rng)]
        usable = [each for each in patterns if each.case != "bare"] if not expression.definite else patterns
        pattern = (usable or patterns)[int(rng.integers(len(usable or patterns)))]
        choice = dict(zip(_WORD_GROUPS, rng.integers(_SYNONYMS, size=len(_WORD_GROUPS)).tolist(), strict=True))
        return pattern, self._by_language[code].grammar.sentence(pattern, expression, choice)

    def write_false_premise(
        self,
        scene: SceneLanguage,
        view: SceneView | None,
        number: int,
        held_out: bool,
        rng: np.random.Generator,
        code: str | None = None,
    ) -> Instruction | None:
        """Returns an instruction that no object of the scene fits; `None` if none is found.

        It names a category that the scene lacks, or a category with a colour or a landmark that no object of this
        category has.

        Args:
            scene: prepared scene.
            view: view at the start, or `None`.
            number: number of the object in the scene graph that gets a wrong colour or landmark.
            held_out: whether to use the held-out sentence patterns.
            rng: random generator.
            code: code of the language; drawn by default.
        """
        code = code or draw_weighted(self.spec.languages, rng)
        groups = [group for group in self._absent(scene, number, code) if group]
        for _ in range(_TRIES):
            group = groups[int(rng.integers(len(groups)))]
            absent = group[int(rng.integers(len(group)))]
            pattern, text = self.say(code, held_out, absent, rng)
            if scene.verifier.is_false_premise(text, self._by_language[code].reader, view):
                return self._instruction(
                    InstructionKind.FALSE_PREMISE,
                    text,
                    code=code,
                    pattern=pattern,
                    expression=absent,
                    features=absent.families,
                    is_minimal=True,
                    fits=0,
                    distractors=scene.distractors(number),
                    rng=rng,
                )
        return None

    def _absent(self, scene: SceneLanguage, number: int, code: str) -> list[list[Expression]]:
        """Returns groups of expressions that may fit no object of the scene. The first group names the categories that
        the scene lacks. The other groups name the category of object `number` with each colour, and next to each other
        kind of object."""
        target, nouns = scene.graph.objects[number], self._by_language[code].grammar.nouns
        kinds = sorted({each.kind for each in scene.graph.objects if each.kind in nouns})
        others = [kind for kind in kinds if kind != target.kind]
        is_coloured = target.colour != UNKNOWN and scene.graph.kinds.of(target.kind).plain
        beside = [Clause(relation=Relation.NEXT_TO, landmarks=(Landmark(kind=k, definite=False),)) for k in others]
        families = self.spec.families
        return [
            [Expression(kind=kind) for kind in CATEGORIES if kind in nouns and kind not in kinds],
            [Expression(kind=target.kind, colour=c) for c in COLOUR_NAMES if is_coloured and Family.COLOUR in families],
            [Expression(kind=target.kind, clauses=(clause,)) for clause in beside if Family.NEAR in families],
        ]

    def _mistake(self, rng: np.random.Generator) -> MistakeKind | None:
        """Draws the kind of error of a sentence; `None` for a sentence without an error."""
        draw = rng.random() if self.spec.mistakes else 1.0
        for kind, share in self.spec.mistakes.items():
            if draw < share:
                return kind
            draw -= share
        return None

    def _instruction(
        self,
        kind: InstructionKind,
        text: str,
        code: str,
        pattern: SentencePattern,
        expression: Expression,
        features: frozenset[Family],
        is_minimal: bool,
        fits: int,
        distractors: int,
        rng: np.random.Generator,
    ) -> Instruction:
        mistake = self._mistake(rng)
        wrong = mistake and with_mistake(
            text, mistake, code=code, vocabulary=self._by_language[code].reader.vocabulary, rng=rng
        )
        return Instruction(
            kind=kind,
            text=wrong or text,
            clean=text if wrong else None,
            mistake=mistake if wrong else None,
            language=code,
            register_name=pattern.register,
            template_id=pattern.template_id,
            held_out=pattern.held_out,
            expression=expression.model_dump_json(),
            features=",".join(sorted(features)),
            is_minimal=is_minimal,
            fits=fits,
            distractors=distractors,
        )


@functools.lru_cache(maxsize=4)
def _composer(text: str) -> Composer:
    return Composer(LanguageSpec.model_validate_json(text))


def composer_of(spec: LanguageSpec) -> Composer:
    """Returns the writer of instructions of a language file; keeps the writers of recently used files."""
    return _composer(spec.model_dump_json())


def features_of(expression: Expression, kind: str) -> frozenset[Family]:
    """Returns the features of an expression, with `SUPERCLASS` if it does not name the object by its own kind."""
    return expression.families | ({Family.SUPERCLASS} if expression.kind != kind else frozenset())


def _led_by_first(groups: Sequence[frozenset[Family]], ranked: Sequence[Family]) -> list[frozenset[Family]]:
    """Returns the groups with the first feature that any group has, without those that add more features than others.

    So a feature leads as often as its weight says, where the scene permits it, and other features are not added to it.
    """
    for feature in ranked:
        led = [group for group in groups if feature in group]
        if led:
            fewest = min(map(len, led))
            return [group for group in led if len(group) == fewest]
    return list(groups)


Probe = tuple[int, SceneView]
"""Number of a target in the scene graph, and a view from a start."""


def explain_impossible(scene: SceneLanguage, spec: LanguageSpec, probes: Sequence[Probe]) -> str:
    """Returns why no probe gets an instruction, and which features are possible; empty if a probe gets an instruction.

    Args:
        scene: prepared scene.
        spec: content of the language file.
        probes: targets with starts, at least one.
    """
    if any(_features(scene, composer_of(spec), probes)):
        return ""
    every = spec.model_copy(update={"features": dict.fromkeys(Family, 1.0), "same_category": 0, "in_view": 0})
    possible = sorted(set(_features(scene, Composer(every.model_copy(update={"balanced": False})), probes)))
    rivals = max(scene.distractors(number) for number, _ in probes)
    what = ", ".join(possible) or f"none with fit = {spec.fit!r}"
    return (
        f"no instruction with these features fits a target; features possible in this scene: {what}; a target has at "
        f"most {rivals} other objects of its category"
    )


def _features(scene: SceneLanguage, composer: Composer, probes: Sequence[Probe]) -> Iterator[str]:
    for place, (number, view) in enumerate(probes):
        rng = np.random.default_rng((composer.spec.seed, place))
        for one in composer.write(scene, view, number, False, rng):
            yield one.features or "category alone"
