"""Implements a fair queue of items by owner.

The next owner is the one with the fewest turns in service, then the least service time. A turn is one item, or several
items that are served together. Runs no thread.
"""

from __future__ import annotations

import threading
from collections import Counter, deque
from collections.abc import Callable, Mapping, Sequence
from typing import Any, Generic, TypeVar

T = TypeVar("T")


def _never(_turn: Sequence[Any], _item: object) -> bool:
    return False


# more threads cannot replace turns, because slow hosts can occupy any number of threads
class FairQueue(Generic[T]):
    """Thread-safe fair queue.

    An owner gets a second turn in service only while no owner with fewer turns in service has waiting items. The
    service time of a new owner starts at the minimum of the others, so the new owner is neither preferred nor
    delayed.

    Args:
        joins: function of the items of a turn and the next waiting item of the same owner, which returns whether that
            item is served in the same turn; by default each item is a turn.
    """

    def __init__(self, joins: Callable[[Sequence[T], T], bool] = _never) -> None:
        self._joins = joins
        self._changed = threading.Condition()
        self._waiting: dict[str, deque[T]] = {}
        self._under_way: Counter[str] = Counter()
        self._served: dict[str, float] = {}
        """Service time of each owner with items, seconds."""
        self._is_open = True

    def put(self, owner: str, item: T) -> None:
        with self._changed:
            self._served.setdefault(owner, min(self._served.values(), default=0.0))
            self._waiting.setdefault(owner, deque()).append(item)
            self._changed.notify()

    def take(self) -> tuple[str, list[T]] | None:
        """Waits for a turn of the next owner and returns its items; returns `None` if the queue is closed.

        The caller must call `give` afterwards.
        """
        with self._changed:
            while self._is_open:
                owner = self._next()
                if owner is not None:
                    self._under_way[owner] += 1
                    return owner, self._turn_of(owner)
                self._changed.wait()
            return None

    def give(self, owner: str, seconds: float, unfinished: Sequence[T] = ()) -> None:
        """Ends a turn.

        Args:
            owner: owner of the items.
            seconds: service time, seconds.
            unfinished: items of the turn whose service continues in a later turn, in their order.
        """
        with self._changed:
            self._served[owner] += seconds
            self._under_way[owner] -= 1
            if unfinished:
                self._waiting.setdefault(owner, deque()).extendleft(reversed(unfinished))
            if not self._under_way[owner] and owner not in self._waiting:
                del self._under_way[owner], self._served[owner]
            self._changed.notify_all()

    def has_others(self, owner: str) -> bool:
        """Returns whether an item of another owner waits."""
        with self._changed:
            return len(self._waiting) > (owner in self._waiting)

    def sizes(self) -> Mapping[str, int]:
        """Returns the number of waiting items and of turns in service by owner."""
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

    def _turn_of(self, owner: str) -> list[T]:
        waiting = self._waiting[owner]
        turn = [waiting.popleft()]
        while waiting and self._joins(turn, waiting[0]):
            turn.append(waiting.popleft())
        if not waiting:
            del self._waiting[owner]
        return turn
