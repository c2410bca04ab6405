"""Transfers results of workers from the archive of the run to the results of the evaluation, each once."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path

from coordinator.ledger.opening import ledger_url_of
from coordinator.ledger.reading.reader import open_ledger
from coordinator.ledger.reading.records import read_archived
from factory.eval.models.messages import EvalTask
from factory.eval.process.run import Pace
from factory.eval.remote.driven import read_driven
from factory.eval.results.store import Store
from schemas.dataset import file_name_of
from schemas.job import episode_id

__all__ = ["Intake"]


class Intake:
    """Record of the finished tasks, including those of earlier runs.

    Args:
        store: store of the results.
        tasks: all tasks of the campaign, by job index.
        tell: progress callback, called for each policy.
    """

    def __init__(self, store: Store, tasks: Mapping[int, EvalTask], tell: Callable[[Pace], None]) -> None:
        self._store, self._tasks, self._tell = store, tasks, tell
        policies = dict.fromkeys(task.policy for task in tasks.values())
        kept = {name: {result.key: result.success for result in store.results(name)} for name in policies}
        self._done = {
            index: kept[task.policy][task.request.key]
            for index, task in tasks.items()
            if task.request.key in kept[task.policy]
        }
        for policy in policies:
            self._tell(self._pace(policy))

    @property
    def left(self) -> Mapping[int, EvalTask]:
        """Unfinished tasks, by job index."""
        return {index: task for index, task in self._tasks.items() if index not in self._done}

    def take(self, root: Path) -> None:
        """Adds the results that were archived since the last call.

        Args:
            root: Directory of the run.
        """
        with open_ledger(ledger_url_of(root)) as connection:
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
        numbers = [index for index, task in self._tasks.items() if task.policy == policy]
        done = [self._done[index] for index in numbers if index in self._done]
        return Pace(policy, len(done), len(numbers), sum(done))
