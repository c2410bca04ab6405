"""LRU cache of the prepared scenes of a renderer. Does not prepare or render scenes."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable
from typing import Generic, Protocol, TypeVar

from schemas.scene import CompiledScene


class _Closable(Protocol):
    def close(self) -> None: ...


Prepared = TypeVar("Prepared", bound=_Closable)


class SceneShelf(Generic[Prepared]):
    """LRU cache of prepared scenes, keyed by the identity of the `CompiledScene` object."""

    def __init__(self, prepare: Callable[[CompiledScene], Prepared], capacity: int) -> None:
        """Creates an empty cache.

        Args:
            prepare: converts a scene to the renderer's format.
            capacity: largest number of prepared scenes, at least 1.
        """
        self._prepare = prepare
        self._capacity = capacity
        self._kept: OrderedDict[int, tuple[CompiledScene, Prepared]] = OrderedDict()

    def take(self, scene: CompiledScene) -> Prepared:
        """Returns the prepared scene; prepares it on a cache miss, and closes the least recently used one if full."""
        key = id(scene)  # unique, because the cache holds a reference to the scene
        if key not in self._kept:
            while len(self._kept) >= self._capacity:
                self._kept.popitem(last=False)[1][1].close()
            self._kept[key] = (scene, self._prepare(scene))
        self._kept.move_to_end(key)
        return self._kept[key][1]

    def clear(self) -> None:
        """Closes all prepared scenes and empties the cache."""
        while self._kept:
            self._kept.popitem()[1][1].close()
