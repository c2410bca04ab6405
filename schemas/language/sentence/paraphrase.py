"""Decides whether a new text is a usable sentence pattern: one slot, an action, no negation, no other content.

Calls no model endpoint. A pattern that passes may still be unusual; its sentences are read back like all others.
"""

from __future__ import annotations

import re
import unicodedata
from functools import cache
from typing import NamedTuple

from schemas.language.sentence.grammar import SLOT, Grammar, alternatives, grammar

_WORD = re.compile(r"[^\W\d_]+")
_MARKS = frozenset('{}()|<>~[]\\`*#"')
_MOST_CHARACTERS = 160


def plain_patterns(source: Grammar, register: str) -> list[str]:
    """Returns the seen patterns of a register, to be paraphrased; of alternatives, only the first is kept."""
    return [alternatives(text)[0] for text in source.patterns[register].seen]


def pattern_fault(code: str, text: str) -> str:
    """Returns why a text cannot be used as a sentence pattern of a language; empty if it can.

    Args:
        code: code of the language.
        text: pattern with a slot such as `{np}` or `{np:dat}`.
    """
    if text != unicodedata.normalize("NFC", text) or not text.isprintable() or len(text) > _MOST_CHARACTERS:
        return "it is too long, or has characters that are not text"
    slots = SLOT.findall(text)
    if len(slots) != 1 or slots[0][0] != "np":
        return "it does not have exactly one slot {np}"
    before, _, after = text.partition("{" + ":".join(filter(None, slots[0])) + "}")
    around = f"{before} {after}"
    if _MARKS & set(around) or any(character.isdigit() for character in around):
        return "it has digits, or special characters such as ( or |"
    source, words = grammar(code), _known_words(code)
    case, governor = slots[0][1], _last_word(before)
    if source.genders and (case or "nom", governor) not in words.governed:
        return "no built-in pattern has this word before a slot with this case, so the case may be wrong"
    return _content_fault(source, around.lower(), set(_WORD.findall(around.lower())), words.content)


def _content_fault(source: Grammar, around: str, words: set[str], content: frozenset[str]) -> str:
    spaced = " " in source.layout

    def holds(word: str) -> bool:
        return word in words if spaced else word in around

    if any(map(holds, source.negations)):
        return "it has a negation"
    if not any(map(holds, source.actions)):
        return "it names no action"
    return "it has words that belong in the slot" if any(map(holds, content)) else ""


class _KnownWords(NamedTuple):
    """Words of the built-in grammar of a language."""

    content: frozenset[str]
    """Words of referring expressions that are not words of patterns."""
    governed: frozenset[tuple[str, str]]
    """Words before slots, each with the grammatical case of its slot."""


@cache
def _known_words(code: str) -> _KnownWords:
    source = grammar(code)
    used = " ".join(f"{each.before} {each.after}" for each in source.sentences).lower()
    spaced = " " in source.layout
    words = set(_WORD.findall(used))
    content = {word for word in _content(source) if (word not in words if spaced else word not in used)}
    governed = {(each.case, _last_word(each.before)) for each in source.sentences}
    return _KnownWords(frozenset(content), frozenset(governed))


def _last_word(before: str) -> str:
    words: list[str] = _WORD.findall(before.lower())
    return words[-1] if words else ""


def _content(source: Grammar) -> set[str]:
    """Returns the words of referring expressions; for a language without spaces, their parts of at least two
    characters."""
    groups = (source.nouns, source.colours, source.sizes, source.sides, source.relations, source.rooms)
    texts = [word for group in groups for words in group.values() for word in words]
    texts = [SLOT.sub(" ", text).partition(":")[0].replace("~", "") for text in (*texts, *source.ordinals.values())]
    if " " not in source.layout:
        return {part for text in texts for part in text.lower().split() if len(part) > 1}
    return {word for text in texts for word in _WORD.findall(text.lower()) if len(word) > 2}
