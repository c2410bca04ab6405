"""Words of routes in one language, read from `data/route_<code>.toml`; writes the sentences of steps."""

from __future__ import annotations

import re
import tomllib
from collections.abc import Mapping
from functools import cache, cached_property
from typing import NamedTuple

import numpy as np

from schemas.base import Model, Name
from schemas.language.kinds import DATA
from schemas.language.route.meaning import RobotSide, RouteStep, StepKind
from schemas.language.sentence.grammar import Grammar, Patterns, SentencePattern, alternatives

SLOT = re.compile(r"\{(np|turn|pass|room|metres)(?::([a-z]+))?\}")
"""Regular expression of a slot in a sentence pattern, with the grammatical case of a referring expression."""
WORD_GROUPS = ("kind", "landmark", "relation", "size", "side", "colour", "article")
_ROUTE = "{route}"
_SYNONYMS = 6


class RouteRegister(Model):
    """Sentence patterns and connecting words of a register."""

    form: Name
    """Form of the verbs: `imperative` or `infinitive`."""
    seen: tuple[str, ...]
    """Patterns of every split but `test_paraphrase_ood`."""
    held_out: tuple[str, ...]
    """Patterns of the split `test_paraphrase_ood`."""
    joiners: tuple[str, ...]
    """Texts between two steps."""
    last: tuple[str, ...]
    """Texts before the last step."""


class ClausePattern(NamedTuple):
    """Pattern of one step without alternatives."""

    clause: str
    """Key of the step, such as `turn_plain`."""
    text: str
    """Text with slots."""
    held_out: bool
    """Whether only the split `test_paraphrase_ood` uses it."""


class RouteWords(Model):
    """Content of `data/route_<code>.toml`."""

    code: Name
    """Code of the language."""
    full_stop: str
    """End of a sentence."""
    metres: tuple[str, str]
    """Text for a distance of one metre, and for several metres."""
    turn_words: dict[RobotSide, tuple[str, ...]]
    """Directions of turns."""
    pass_words: dict[RobotSide, tuple[str, ...]]
    """Sides of objects that are passed."""
    rooms: dict[Name, tuple[str, ...]]
    """Rooms that are entered, with article and case."""
    clauses: dict[Name, dict[Name, Patterns]]
    """Patterns of steps by form of the verb."""
    registers: dict[Name, RouteRegister]
    """Registers."""

    @cached_property
    def patterns(self) -> dict[str, tuple[ClausePattern, ...]]:
        """Patterns of steps without alternatives, by form of the verb."""
        return {
            form: tuple(
                ClausePattern(clause, one, held_out)
                for clause, group in templates.items()
                for held_out, texts in ((False, group.seen), (True, group.held_out))
                for text in texts
                for one in alternatives(text)
            )
            for form, templates in self.clauses.items()
        }

    @cached_property
    def frames(self) -> tuple[SentencePattern, ...]:
        """Sentence patterns of whole routes; the field `case` of a pattern contains the form of its verbs."""
        frames = []
        for register, register_words in self.registers.items():
            texts = [
                (text, held)
                for held, group in ((False, register_words.seen), (True, register_words.held_out))
                for text in group
            ]
            whole = [(one, held) for text, held in texts for one in alternatives(text)]
            for number, (text, held_out) in enumerate(whole, 1):
                before, _, after = text.partition(_ROUTE)
                name = f"{self.code}_route_{register}_{number:03d}"
                frames.append(
                    SentencePattern(
                        name, register, held_out=held_out, before=before, case=register_words.form, after=after
                    )
                )
        return tuple(frames)

    def clause(self, step: RouteStep, form: str, held_out: bool, nouns: Grammar, rng: np.random.Generator) -> str:
        """Returns the words of a step without a capital letter; draws pattern and synonyms at random."""
        key = clause_of(step)
        usable = [each for each in self.patterns[form] if each.clause == key and each.held_out == held_out]
        text = usable[int(rng.integers(len(usable)))].text
        choice = dict(zip(WORD_GROUPS, rng.integers(_SYNONYMS, size=len(WORD_GROUPS)).tolist(), strict=True))
        return SLOT.sub(lambda slot: self._word(step, slot[1], slot[2] or "nom", nouns, choice), text)

    def _word(self, step: RouteStep, slot: str, case: str, nouns: Grammar, choice: Mapping[str, int]) -> str:
        number = choice["side"]
        match slot:
            case "np":
                assert step.named is not None
                return nouns.phrase(step.named, case, choice)
            case "metres":
                return self.metres[step.metres != 1].format(n=step.metres)
            case "room":
                words = self.rooms[str(step.room)]
            case _:
                assert step.side is not None
                words = (self.turn_words if slot == "turn" else self.pass_words)[step.side]
        return words[number % len(words)]


def clause_of(step: RouteStep) -> str:
    """Returns the key of the patterns of a step."""
    if step.kind is StepKind.TURN:
        return f"turn_{step.size}"
    return str(step.kind) if step.room is None else f"{step.kind}_into"


@cache
def route_words(code: str) -> RouteWords:
    return RouteWords.model_validate(tomllib.loads((DATA / f"route_{code}.toml").read_text(encoding="utf-8")))
