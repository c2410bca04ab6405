"""Encodes the instruction of an observation: as text, as token indices of a vocabulary, or not at all.

Defines the Gymnasium spaces of the instruction. Does not use the simulation.
"""

from __future__ import annotations

import string
from collections.abc import Sequence
from typing import Any, Literal, cast, get_args, overload

import numpy as np
from gymnasium import spaces
from gymnasium.vector.utils import read_from_shared_memory
from numpy.typing import NDArray

from factory.dataset.reader import Dataset
from factory.train.vocabulary import MAX_WORDS, encode, vocabulary
from schemas.errors import UsageError
from schemas.storage.place import Place
from schemas.terms import COLOUR_NAMES

InstructionKind = Literal["text", "tokens", "none"]
MAX_INSTRUCTION = 256
_CHARSET = "".join(sorted(set(string.printable)))


class InstructionText(spaces.Text):
    """Space of texts of up to `MAX_INSTRUCTION` characters, whose current text `AsyncVectorEnv` returns at every step.

    Gymnasium 1.4 reads the texts of a `Text` space from shared memory only once, when the environments are created.
    """

    def __init__(self) -> None:
        super().__init__(MAX_INSTRUCTION, min_length=0, charset=_CHARSET)


class _SharedTexts(Sequence[str]):
    """Current texts in shared memory; a deep copy, which `AsyncVectorEnv` returns, is a tuple of strings."""

    def __init__(self, space: InstructionText, memory: Any, count: int) -> None:
        self._space, self._memory, self._count = space, memory, count

    def __len__(self) -> int:
        return self._count

    @overload
    def __getitem__(self, place: int) -> str: ...

    @overload
    def __getitem__(self, place: slice) -> tuple[str, ...]: ...

    def __getitem__(self, place: int | slice) -> str | tuple[str, ...]:
        return self._read()[place]

    def __deepcopy__(self, memo: dict[int, Any]) -> tuple[str, ...]:
        return self._read()

    def _read(self) -> tuple[str, ...]:
        read = read_from_shared_memory.dispatch(spaces.Text)
        return cast("tuple[str, ...]", read(self._space, self._memory, self._count))


@read_from_shared_memory.register(InstructionText)
def _read_texts(space: InstructionText, shared_memory: Any, n: int = 1) -> _SharedTexts:
    return _SharedTexts(space, shared_memory, n)


def instruction_space(kind: InstructionKind, words: Sequence[str]) -> spaces.Space[Any] | None:
    """Returns the Gymnasium space of the instruction; `None` for observations without an instruction.

    Args:
        kind: Encoding of the instruction.
        words: Vocabulary, for `tokens`.

    Raises:
        UsageError: The kind is not valid.
    """
    if kind == "text":
        return InstructionText()
    if kind == "tokens":
        return spaces.MultiDiscrete(np.full(MAX_WORDS, len(words), np.int64))
    if kind == "none":
        return None
    raise UsageError(f"instruction={kind!r} is not valid; valid values: {', '.join(get_args(InstructionKind))}")


def encode_instruction(kind: InstructionKind, instruction: str, words: Sequence[str]) -> str | NDArray[np.int64]:
    """Returns the instruction as an element of its space."""
    return encode(instruction, words) if kind == "tokens" else instruction


def words_for(kind: InstructionKind, words: Sequence[str] | None, root: Place) -> tuple[str, ...]:
    """Returns the vocabulary: the given words, or those of templates, categories, colours and the dataset.

    Args:
        kind: Encoding of the instruction; only `tokens` has a vocabulary.
        words: Words by index, such as `vocabulary` of an environment; `None` uses the words of the dataset.
        root: Location of the dataset. The vocabulary includes the instructions of all episodes, so it is the same
            for all splits.

    Raises:
        UsageError: `words` is given for another kind, or is not the vocabulary of an environment.
        WorldError: The dataset cannot be read.
    """
    if kind != "tokens":
        if words is not None:
            raise UsageError(f"a vocabulary requires instruction='tokens', found instruction={kind!r}")
        return ()
    if words is None:
        return vocabulary((*COLOUR_NAMES, *Dataset(root).column("instruction").to_pylist()))
    if tuple(words[:2]) != vocabulary()[:2]:
        raise UsageError(
            f"not a valid vocabulary, because it begins with {tuple(words[:2])}; pass `env.unwrapped.vocabulary`"
        )
    return tuple(words)
