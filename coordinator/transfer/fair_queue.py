"""Implements a fair queue of items by owner.

The next owner is the one with the fewest items in service, then the least service time. Runs no thread.
"""

from __future__ import annotations

import threading
from collections import Counter, deque
from collections.abc import Mapping
from typing import Generic, TypeVar

T = TypeVar("T")


class FairQueue(Generic[T]):
    """Thread-safe fair queue.

    An owner gets a second item in service only while no owner with fewer waits. The service time of a new owner
    starts at the minimum of the others, so that it is neither preferred nor delayed.
    """

    def __init__(self) -> None:
        self._changed = threading.Condition()
        self._waiting: dict[str, deque[T]] = {}
        self._under_way: Counter[str] = Counter()
        self._served: dict[str, float] = {}
        """Service time of each owner with items, seconds."""
        self._is_open = True

    def put(self, owner: str, item: T) -> None:
        """Appends an item."""
        with self._changed:
            self._served.setdefault(owner, min(self._served.values(), default=0.0))
            self._waiting.setdefault(owner, deque()).append(item)
            self._changed.notify()

    def take(self) -> tuple[str, T] | None:
        """Waits for an item of the next owner; returns `None` if the queue is closed.

        The caller must call `give` afterwards.
        """
        with self._changed:
            while self._is_open:
                owner = self._next()
                if owner is not None:
                    self._under_way[owner] += 1
                    item = self._waiting[owner].popleft()
                    if not self._waiting[owner]:
                        del self._waiting[owner]
                    return owner, item
                self._changed.wait()
            return None

    def give(self, owner: str, seconds: float, unfinished: T | None = None) -> None:
        """Ends the service of an item.

        Args:
            owner: owner of the item.
            seconds: service time, seconds.
            unfinished: the item, if its service continues later.
        """
        with self._changed:
            self._served[owner] += seconds
            self._under_way[owner] -= 1
            if unfinished is not None:
                self._waiting.setdefault(owner, deque()).appendleft(unfinished)
            if not self._under_way[owner] and owner not in self._waiting:
                del self._under_way[owner], self._served[owner]
            self._changed.notify_all()

    def has_others(self, owner: str) -> bool:
        """Returns whether an item of another owner waits."""
        with self._changed:
            return len(self._waiting) > (owner in self._waiting)

    def sizes(self) -> Mapping[str, int]:
        """Returns the number of waiting and served items by owner."""
        with self._changed:
            return {owner: len(self._waiting.get(owner, ())) + self._under_way[owner] for owner in self._served}

    def close(self) -> list[T]:
        """Ends every `take` and returns the waiting items."""
        with self._changed:
            self._is_open = False
            self._changed.notify_all()
            left = [item for items in self._waiting.values() for item in items]
            self._waiting.clear()
            return left

    def _next(self) -> str | None:
        return min(self._waiting, key=lambda owner: (self._under_way[owner], self._served[owner]), default=None)
