"""Vocabulary of the instructions: encodes words as token indices. Pure functions; checkpoints contain their vocabulary.

The vocabulary contains the words of all templates, including paraphrase templates, the categories and the colours. The
embedding of a word that occurs in no training sentence keeps its initial value, so the words of the test splits give
the policy no information.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence

import numpy as np
from numpy.typing import NDArray

from schemas.instruction.templates import TEMPLATES, say_category
from schemas.terms import CATEGORIES

PAD, UNKNOWN, ANY = 0, 1, 2
"""Special indices: padding, a word outside of the vocabulary, and the replacement of an instruction when language is
ablated."""
_SPECIAL = ("<pad>", "<unknown>", "<any>")
MAX_WORDS = 16
"""Maximum number of encoded words; the longest template with the longest category has 11."""
_WORD = re.compile(r"[a-z0-9']+")
_SLOT = re.compile(r"\{\w+\}")
_SIDES = (
    ("left", "right"),
    ("leftmost", "rightmost"),
    ("links", "rechts"),
    ("linken", "rechten"),
    ("izquierda", "derecha"),
)
"""Pairs of words that are exchanged in the instruction of a mirrored image."""


def split_words(text: str) -> list[str]:
    """Returns the words of a text in lower case, without punctuation."""
    return _WORD.findall(text.lower())


def vocabulary(instructions: Iterable[str] = ()) -> tuple[str, ...]:
    """Returns the words by index: first the special words, then the others in alphabetical order.

    Args:
        instructions: Instructions of the training data; imported scenes can add categories and colours. If one of two
            opposite sides, such as left and right, is among their words, the other one is added.
    """
    texts = [_SLOT.sub(" ", text) for text in TEMPLATES.values()]
    texts += [say_category(category) for category in CATEGORIES]
    words = {word for text in (*texts, *instructions) for word in split_words(text)}
    words |= {word for pair in _SIDES if words & set(pair) for word in pair}
    return (*_SPECIAL, *sorted(words))


def mirrored_words(words: Sequence[str]) -> NDArray[np.int64]:
    """Returns the index of each word in the instruction of a mirrored image, (V,): left and right are swapped.

    Args:
        words: Vocabulary.
    """
    # half of the frames are mirrored: "on your left" would be false in them, and the network could not learn the words
    number = {word: place for place, word in enumerate(words)}
    out = np.arange(len(words), dtype=np.int64)
    for one, other in _SIDES:
        if one in number and other in number:
            out[number[one]], out[number[other]] = number[other], number[one]
    return out


def encode(instruction: str, words: Sequence[str], ablate: bool = False) -> NDArray[np.int64]:
    """Encodes an instruction as token indices.

    Args:
        instruction: Any text, which may be empty.
        words: Vocabulary.
        ablate: Whether to replace the instruction by one constant token.

    Returns:
        (MAX_WORDS,) indices, padded with `PAD`; the first index is never `PAD`, so the LSTM has an input.
    """
    if ablate:
        indices = [ANY]
    else:
        number = {word: place for place, word in enumerate(words)}
        indices = [number.get(word, UNKNOWN) for word in split_words(instruction)[:MAX_WORDS]] or [UNKNOWN]
    out = np.full(MAX_WORDS, PAD, np.int64)
    out[: len(indices)] = indices
    return out
