"""Kinds of objects: superclasses, kinds that look alike, and landmarks recognised by the name of their prim."""

from __future__ import annotations

import re
import tomllib
from collections.abc import Iterable
from functools import cache, cached_property
from pathlib import Path
from types import MappingProxyType

from schemas.base import Model, Name

DATA = Path(__file__).parent / "data"
UNKNOWN = "unknown"
"""Colour of an object without a dominant colour; material of an object without a recorded material."""
UNNAMED = "thing"
"""Kind of an object that no word names, but that a viewer may take for another kind."""
_WORD = re.compile(r"[A-Z]?[a-z]+|[A-Z]+(?![a-z])")


class ObjectKind(Model):
    """Properties of a kind of objects."""

    plain: bool = True
    """Whether its colour can be named."""
    like: tuple[Name, ...] = ()
    """Kinds that a viewer may confuse with this kind."""
    prims: tuple[tuple[str, ...], ...] = ()
    """Words of the prim's name that identify a landmark without a category."""
    of: Name | None = None
    """Category of which this kind is a special case, such as a pile of boxes of the category box. An object of the
    category has this kind if the name of its prim contains the words in `prims`."""
    surface: bool = False
    """Whether things are put on its top, so the top can be called empty."""
    material: bool = False
    """Whether its material can be named."""
    sized: bool = True
    """Whether objects of this kind are compared by size; false if they are flat, or include another thing, such as the
    mirror above a sink."""


_ALIKE_COLOURS = frozenset({"brown", "yellow"})


def may_be_called(colour: str, word: str) -> bool:
    """Returns whether a viewer may call an object of a colour by the word for another colour."""
    return colour in (UNKNOWN, word) or {colour, word} == _ALIKE_COLOURS


class RoomRule(Model):
    """Condition under which a room has a type."""

    has: tuple[Name, ...] = ()
    """Kinds of the objects that the room must contain."""
    count: int = 1
    """Smallest number of these objects."""
    aspect: float | None = None
    """Smallest ratio of length and width, for rooms without `has`."""


class Kinds(Model):
    """Content of `kinds.toml`."""

    superclasses: dict[Name, tuple[Name, ...]]
    """Kinds of each superclass."""
    kinds: dict[Name, ObjectKind]
    """Known kinds; a category that is not among them has the default properties."""
    seen_as: dict[Name, tuple[tuple[str, ...], ...]]
    """Words of prim names for each kind: a viewer may take a prim with such a name for an object of the kind. The words
    of the kind's own name have the same effect."""
    rooms: dict[Name, RoomRule]
    """Types of rooms, in the order in which they are tested."""

    def of(self, kind: str) -> ObjectKind:
        return self.kinds.get(kind, _DEFAULT)

    @cached_property
    def _above(self) -> MappingProxyType[str, tuple[str, ...]]:
        members = {kind for group in self.superclasses.values() for kind in group}
        return MappingProxyType(
            {kind: tuple(name for name, group in self.superclasses.items() if kind in group) for kind in members}
        )

    def superclasses_of(self, kind: str) -> tuple[str, ...]:
        return self._above.get(kind, ())

    def kinds_of(self, word: str) -> frozenset[str]:
        """Returns the kinds that a kind or superclass contains."""
        return frozenset(self.superclasses.get(word, (word,)))

    def borderline_of(self, word: str) -> frozenset[str]:
        """Returns the kinds that are borderline cases of a kind or superclass, because they look alike."""
        if word not in self._alike:
            inside = self.kinds_of(word)
            alike = {other for kind in inside for other in self.of(kind).like}
            alike |= {kind for kind, definition in self.kinds.items() if inside.intersection(definition.like)}
            self._alike[word] = frozenset(alike - inside)
        return self._alike[word]

    @cached_property
    def _alike(self) -> dict[str, frozenset[str]]:
        return {}

    @cached_property
    def _prims(self) -> tuple[tuple[frozenset[str], str], ...]:
        prims = [(frozenset(words), kind) for kind, definition in self.kinds.items() for words in definition.prims]
        return tuple(sorted(prims, key=lambda entry: -len(entry[0])))

    def landmark_of(self, segments: Iterable[str]) -> tuple[str, int] | None:
        """Returns the kind of a landmark and the number of the segment of the prim path that names it, or `None`."""
        for number, segment in reversed(list(enumerate(segments))):
            words = frozenset(word.lower() for word in _WORD.findall(segment))
            for wanted, kind in self._prims:
                if wanted <= words:
                    return kind, number
        return None

    @cached_property
    def _seen(self) -> tuple[tuple[frozenset[str], str], ...]:
        words_of_kinds = [(frozenset(kind.split("_")), kind) for kind in self.kinds]
        return (*words_of_kinds, *((frozenset(words), kind) for kind, group in self.seen_as.items() for words in group))

    def special_of(self, category: str, segments: Iterable[str]) -> str:
        """Returns the kind of an object: the special kind of its category that its prim path names, or the category."""
        named = self.landmark_of(segments)
        return named[0] if named is not None and self.of(named[0]).of == category else category

    def seen_in(self, segments: Iterable[str]) -> tuple[tuple[str, ...], int] | None:
        """Returns the kinds for which a viewer may mistake a prim, and the number of the segment that names them."""
        for number, segment in reversed(list(enumerate(segments))):
            words = frozenset(word.lower() for word in _WORD.findall(segment))
            seen_kinds = dict.fromkeys(kind for wanted, kind in self._seen if wanted <= words)
            if seen_kinds:
                return tuple(seen_kinds), number
        return None


_DEFAULT = ObjectKind()


@cache
def kinds() -> Kinds:
    """Returns the content of `kinds.toml`."""
    return Kinds.model_validate(tomllib.loads((DATA / "kinds.toml").read_text(encoding="utf-8")))
