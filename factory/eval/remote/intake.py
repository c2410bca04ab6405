"""Transfers results of workers from the archive of the run to the results of the evaluation, each once."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path

from coordinator.ledger.opening import ledger_url_of
from coordinator.ledger.reading.look import look_into
from coordinator.ledger.reading.records import read_archived
from factory.eval.models.messages import EvalOrder
from factory.eval.process.run import Pace
from factory.eval.remote.driven import read_driven
from factory.eval.results.store import Store
from schemas.dataset import file_name_of
from schemas.job import episode_id

__all__ = ["Intake"]


class Intake:
    """Knows which orders are done; those that an earlier run has finished are so from the start.

    Args:
        store: Store of the results.
        orders: all of the campaign, by job index.
        tell: Progress callback, called for each policy.
    """

    def __init__(self, store: Store, orders: Mapping[int, EvalOrder], tell: Callable[[Pace], None]) -> None:
        self._store, self._orders, self._tell = store, orders, tell
        policies = dict.fromkeys(order.policy for order in orders.values())
        kept = {name: {result.key: result.success for result in store.results(name)} for name in policies}
        self._done = {
            index: kept[order.policy][order.question.key]
            for index, order in orders.items()
            if order.question.key in kept[order.policy]
        }
        for policy in policies:
            self._tell(self._pace(policy))

    @property
    def left(self) -> Mapping[int, EvalOrder]:
        """The orders whose results are still wanted."""
        return {index: order for index, order in self._orders.items() if index not in self._done}

    def take(self, root: Path) -> None:
        """Adds the results that were archived since the last call.

        Args:
            root: Directory of the run.
        """
        with look_into(ledger_url_of(root)) as connection:
            archived = read_archived(connection)
        for index in sorted(archived - self._done.keys()):
            with (root / file_name_of(episode_id(index))).open("rb") as file:
                driven = read_driven(file)
            policy = driven.result.policy
            if self._store.note_of(policy) is None:
                self._store.note(driven.note)
            self._store.add(driven.result)
            self._done[index] = driven.result.success
            self._tell(self._pace(policy))

    def _pace(self, policy: str) -> Pace:
        numbers = [index for index, order in self._orders.items() if order.policy == policy]
        done = [self._done[index] for index in numbers if index in self._done]
        return Pace(policy, len(done), len(numbers), sum(done))
