"""Adds a typing or speech error to a sentence, and checks that a sentence has exactly one error.

The error never changes the meaning: a mistyped word is not a word of the grammar, and resembles only the intended word.
"""

from __future__ import annotations

import re
from collections.abc import Collection, Iterator
from enum import StrEnum
from types import MappingProxyType

import numpy as np

_WORD = re.compile(r"[^\W\d_]{4,}")
_SPACED = re.compile(r"\S+")
_KEYS = ("qwertyuiop", "asdfghjkl", "zxcvbnm")
_NEXT_KEYS = MappingProxyType(
    {key: row[max(0, place - 1) : place] + row[place + 1 : place + 2] for row in _KEYS for place, key in enumerate(row)}
)
_FILLERS = MappingProxyType(
    {"en": (" uh", " um", " er"), "de": (" äh", " ähm", " hm"), "es": (" eh", " este", " mmm"), "zh": ("嗯，", "呃，")}
)
_TRIES = 8


class MistakeKind(StrEnum):
    """Kind of an error in a sentence."""

    TYPING = "typing"  # swapped letters; a missing or doubled letter; the letter of a neighbouring key
    SPEECH = "speech"  # filler, or repeated word


def with_mistake(
    text: str, kind: MistakeKind, code: str, vocabulary: Collection[str], rng: np.random.Generator
) -> str | None:
    """Returns a sentence with one error; `None` if none can be added. Chinese sentences have no typing errors.

    Args:
        text: clean sentence.
        kind: kind of the error.
        code: code of the language.
        vocabulary: words of the grammar, in lower case.
        rng: random generator.
    """
    for _ in range(0 if (code, kind) == ("zh", MistakeKind.TYPING) else _TRIES):
        changed = _mistyped(text, rng) if kind is MistakeKind.TYPING else _misspoken(text, code, rng)
        if changed is not None and not mistake_fault(changed, text, kind=kind, code=code, vocabulary=vocabulary):
            return changed
    return None


def mistake_fault(text: str, clean: str, kind: MistakeKind, code: str, vocabulary: Collection[str]) -> str:
    """Returns why a text cannot result from one error of a kind in the clean sentence; empty if it can.

    Args:
        text: sentence with an error.
        clean: sentence without it.
        kind: kind of the error.
        code: code of the language.
        vocabulary: words of the grammar, in lower case.
    """
    # compares with the clean sentence: a reader that tolerates errors would accept "left" for "lift"
    if kind is MistakeKind.SPEECH:
        return "" if _is_misspoken(text, clean, code) else "it is not the clean sentence with a filler or a repetition"
    ours, theirs = _WORD.split(text), _WORD.split(clean)
    pairs = list(zip(_WORD.findall(text), _WORD.findall(clean), strict=False))
    changed = [(one.lower(), two.lower()) for one, two in pairs if one != two]
    if ours != theirs or len(changed) != 1:
        return "it is not the clean sentence with one mistyped word"
    wrong, right = changed[0]
    if not _is_one_slip(wrong, right):
        return f"{wrong!r} is not {right!r} with one typing error"
    like = [word for word in vocabulary if word != right and (word == wrong or _is_one_slip(wrong, word))]
    return f"{wrong!r} resembles {like[0]!r}" if like else ""


def _mistyped(text: str, rng: np.random.Generator) -> str | None:
    words = list(_WORD.finditer(text))
    if not words or not text.isprintable():
        return None
    word = words[int(rng.integers(len(words)))]
    at = int(rng.integers(1, len(word[0]) - 1))
    slips = list(_slips(word[0], at))
    return text[: word.start()] + slips[int(rng.integers(len(slips)))] + text[word.end() :]


def _slips(word: str, at: int) -> Iterator[str]:
    """Yields the variants of a word with one typing error at letter number `at`, which is an inner letter."""
    yield word[:at] + word[at + 1] + word[at] + word[at + 2 :]
    yield word[:at] + word[at + 1 :]
    yield word[:at] + word[at] + word[at:]
    yield from (word[:at] + key + word[at + 1 :] for key in _NEXT_KEYS.get(word[at], ""))


def _is_one_slip(wrong: str, right: str) -> bool:
    """Returns whether two words differ by two swapped letters, or by one missing, additional or replaced letter."""
    if abs(len(wrong) - len(right)) > 1 or wrong == right:
        return False
    first = next((at for at, (one, two) in enumerate(zip(wrong, right, strict=False)) if one != two), None)
    at = min(len(wrong), len(right)) if first is None else first
    rest, other = wrong[at:], right[at:]
    swapped = len(rest) > 1 and rest[:2] == other[1::-1] and rest[2:] == other[2:]
    return swapped or rest[1:] == other[1:] or rest == other[1:] or rest[1:] == other


def _misspoken(text: str, code: str, rng: np.random.Generator) -> str | None:
    fillers = _FILLERS[code]
    filler = fillers[int(rng.integers(len(fillers)))]
    words = [] if code == "zh" else list(_SPACED.finditer(text))[:-1]
    if not words:
        return filler + text if code == "zh" else None
    word = words[int(rng.integers(len(words)))]
    added = f" {word[0]}" if word[0].isalpha() and rng.random() < 0.5 else filler
    return text[: word.end()] + added + text[word.end() :]


def _is_misspoken(text: str, clean: str, code: str) -> bool:
    more = len(text) - len(clean)
    for at in range(len(clean) if more > 0 else 0):
        if text[:at] == clean[:at] and text[at + more :] == clean[at:]:
            added, before = text[at : at + more], clean[:at].rpartition(" ")[2]
            if added in _FILLERS[code] or (before.isalpha() and added == f" {before}"):
                return True
    return False
