"""The few scenes a renderer keeps ready, least recently shown out first.

Keeps and forgets; it never builds or draws what it keeps.
"""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable
from typing import Generic, Protocol, TypeVar

from schemas.scene import CompiledScene

__all__ = ["SceneShelf"]


class _Closable(Protocol):
    def close(self) -> None: ...


Prepared = TypeVar("Prepared", bound=_Closable)


class SceneShelf(Generic[Prepared]):
    """Prepared scenes by the identity of the `CompiledScene` object they were made from."""

    def __init__(self, prepare: Callable[[CompiledScene], Prepared], capacity: int) -> None:
        """Makes an empty shelf.

        Args:
            prepare: makes of a scene what the renderer draws.
            capacity: how many prepared scenes are kept; at least 1.
        """
        self._prepare = prepare
        self._capacity = capacity
        self._kept: OrderedDict[int, tuple[CompiledScene, Prepared]] = OrderedDict()

    def take(self, scene: CompiledScene) -> Prepared:
        """Returns the prepared scene, made now if it is not kept; closes the one that has to make room."""
        key = id(scene)  # stays unique, because the scene itself is kept beside what was made of it
        if key not in self._kept:
            while len(self._kept) >= self._capacity:
                self._kept.popitem(last=False)[1][1].close()
            self._kept[key] = (scene, self._prepare(scene))
        self._kept.move_to_end(key)
        return self._kept[key][1]

    def clear(self) -> None:
        """Closes everything."""
        while self._kept:
            self._kept.popitem()[1][1].close()
