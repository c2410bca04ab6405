"""The vocabulary of the instructions: words to numbers. Pure; the list of a checkpoint is part of the checkpoint.

The words are those of all templates, the paraphrased ones included, the categories and the colours. A word that no
training sentence had keeps the vector it was drawn with, and learns nothing: the list hides no answers.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence

import numpy as np
from numpy.typing import NDArray

from schemas.language import TEMPLATES, say_category
from schemas.terms import CATEGORIES

__all__ = ["ANY", "MAX_WORDS", "PAD", "UNKNOWN", "encode", "split_words", "vocabulary"]

PAD, UNKNOWN, ANY = 0, 1, 2
"""Numbers of what is no word: filling, a word outside of the list, and the whole instruction of an ablated twin."""
_SPECIAL = ("<pad>", "<unknown>", "<any>")
MAX_WORDS = 16
"""Words of an instruction that are read; the longest template with the longest category has 11."""
_WORD = re.compile(r"[a-z0-9']+")
_SLOT = re.compile(r"\{\w+\}")


def split_words(text: str) -> list[str]:
    """Returns the words of a text in lower case, without punctuation."""
    return _WORD.findall(text.lower())


def vocabulary(instructions: Iterable[str] = ()) -> tuple[str, ...]:
    """Returns the words by number: the special ones first, the others in alphabetical order.

    Args:
        instructions: of the training data; own scenes bring categories and colours of their own.
    """
    texts = [_SLOT.sub(" ", text) for text in TEMPLATES.values()]
    texts += [say_category(category) for category in CATEGORIES]
    words = {word for text in (*texts, *instructions) for word in split_words(text)}
    return (*_SPECIAL, *sorted(words))


def encode(instruction: str, words: Sequence[str], ablate: bool = False) -> NDArray[np.int64]:
    """Returns an instruction as numbers.

    Args:
        instruction: any text; also an empty one.
        words: the vocabulary.
        ablate: whether the one constant token stands in its place.

    Returns:
        (MAX_WORDS,) numbers, filled up with `PAD`; never `PAD` at the first place, so that there is something to read.
    """
    if ablate:
        found = [ANY]
    else:
        number = {word: place for place, word in enumerate(words)}
        found = [number.get(word, UNKNOWN) for word in split_words(instruction)[:MAX_WORDS]] or [UNKNOWN]
    out = np.full(MAX_WORDS, PAD, np.int64)
    out[: len(found)] = found
    return out
