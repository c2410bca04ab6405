"""LRU cache of the prepared scenes of a renderer. Does not prepare or render scenes."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable, Hashable
from typing import Generic, Protocol, TypeVar

KEPT_SCENES = 2
"""Default number of prepared scenes of a renderer."""


class _Closable(Protocol):
    def close(self) -> None: ...


Scene = TypeVar("Scene")
Prepared = TypeVar("Prepared", bound=_Closable)


class PreparedSceneCache(Generic[Scene, Prepared]):
    """LRU cache of prepared scenes by key."""

    def __init__(self, prepare: Callable[[Scene], Prepared], capacity: int) -> None:
        """Creates an empty cache.

        Args:
            prepare: converts a scene to the renderer's format.
            capacity: largest number of prepared scenes, at least 1.
        """
        self._prepare = prepare
        self._capacity = capacity
        self._kept: OrderedDict[Hashable, tuple[Callable[[], Scene], Prepared]] = OrderedDict()

    @property
    def keys(self) -> tuple[Hashable, ...]:
        """Keys of the prepared scenes, the most recently used one last."""
        return tuple(self._kept)

    def take(self, key: Hashable, read: Callable[[], Scene]) -> Prepared:
        """Returns the prepared scene; prepares it on a cache miss, and closes the least recently used one if full.

        Args:
            key: key of the scene.
            read: returns the scene; called on a cache miss, and referenced while the scene is prepared.
        """
        if key not in self._kept:
            self.make_room()
            self._kept[key] = (read, self._prepare(read()))
        self._kept.move_to_end(key)
        return self._kept[key][1]

    def make_room(self) -> None:
        """Closes the least recently used scenes until one more fits."""
        while len(self._kept) >= self._capacity:
            self._kept.popitem(last=False)[1][1].close()

    def clear(self) -> None:
        """Closes all prepared scenes and empties the cache."""
        while self._kept:
            self._kept.popitem()[1][1].close()
