"""A campaign on one machine: policies x variants x episodes over driving processes, kept as they finish.

Owns the processes and ends them all when it ends; prints nothing, a listener is told.
"""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from dataclasses import dataclass

from factory.eval.models.messages import DriverOrder, EvalReport, EvalReportKind, EvalTask
from factory.eval.models.result import EpisodeResult
from factory.eval.policies.note import note_of
from factory.eval.process.broken_off import result_of_end
from factory.eval.process.driver_process import DriverEnded, DriverProcess
from factory.eval.results.store import Store
from factory.eval.specs.campaign import Campaign, tasks_for, with_actions
from factory.eval.specs.from_dataset import Places
from schemas.errors import UsageError, WorldError

__all__ = ["Pace", "run_campaign"]

_POLL_S = 0.05
_TRIES = 2
"""How often an episode is begun when the simulation, not the policy, dies."""


@dataclass(frozen=True)
class Pace:
    """How far a campaign is."""

    policy: str
    done: int
    """Of the policy, earlier runs included."""
    total: int
    successes: int


PaceCallback = Callable[[Pace], None]


def run_campaign(campaign: Campaign, store: Store, stop: threading.Event, tell: PaceCallback) -> bool:
    """Drives every episode that is not finished yet; returns whether all are done, or `stop` was set before.

    Args:
        campaign: what to do.
        store: holds the finished episodes and takes the new ones.
        stop: leave at once; nothing finished is lost.
        tell: told after every episode.

    Raises:
        UsageError: a policy cannot be made, or the specs do not fit the dataset.
        WorldError: a policy's server is away, or simulations die.
    """
    places = Places(campaign.root)
    with ExitStack() as stack:
        seats = [DriverProcess() for _ in range(campaign.processes)]
        for seat in seats:
            stack.callback(seat.kill)
        for policy in campaign.policies:
            if not _Round(campaign, policy, places, store, seats, stop, tell).run():
                return False
    return True


class _Round:
    """All episodes of one policy."""

    def __init__(
        self,
        campaign: Campaign,
        policy: str,
        places: Places,
        store: Store,
        seats: list[DriverProcess],
        stop: threading.Event,
        tell: PaceCallback,
    ) -> None:
        self._campaign, self._policy, self._store = campaign, policy, store
        self._tasks = tasks_for(campaign, policy, places)
        self._packages = {
            spec.scene_sha256: places.path(spec.scene, spec.scene_sha256) for spec in campaign.specs.specs
        }
        self._seats, self._stop, self._tell = seats, stop, tell
        self._deaths: dict[int, int] = {}

    def run(self) -> bool:
        """Returns whether all are done."""
        tasks = self._tasks
        done = {result.key: result.success for result in self._store.results(self._policy)}
        waiting = deque(task for task in tasks if task.request.key not in done)
        successes = sum(done.get(task.request.key, False) for task in tasks)
        pace = Pace(self._policy, len(tasks) - len(waiting), len(tasks), successes)
        self._tell(pace)
        while pace.done < pace.total and not self._stop.is_set():
            for result in self._turns(waiting):
                self._keep(result)
                pace = Pace(self._policy, pace.done + 1, pace.total, pace.successes + result.success)
                self._tell(pace)
        return pace.done >= pace.total

    def _turns(self, waiting: deque[EvalTask]) -> Iterator[EpisodeResult]:
        """Gives every idle seat a task and hears every busy one once."""
        busy = 0
        for seat in self._seats:
            if seat.current is None and waiting:
                seat.give(self._order(waiting.popleft()))
            busy += seat.current is not None
        for seat in self._seats:
            if seat.current is None:
                continue
            heard = seat.hear(_POLL_S / max(1, busy))
            result = self._after_end(seat, heard, waiting) if isinstance(heard, DriverEnded) else self._after(heard)
            if result is not None:
                seat.current = None
                yield result

    def _order(self, task: EvalTask) -> DriverOrder:
        package = self._packages[task.request.spec.scene_sha256]
        return DriverOrder(task=with_actions(task, self._campaign.root), package=package)

    def _after(self, report: EvalReport | None) -> EpisodeResult | None:
        if report is None:
            return None
        if report.kind is EvalReportKind.REFUSED:
            raise UsageError(report.detail) if report.exit_code == 2 else WorldError(report.detail)
        if report.kind is EvalReportKind.AWAY:
            kept = f"the results so far are in {self._store.root}"
            raise WorldError(f"{report.detail}; {kept}: start the server and run the same command again")
        if report.kind is EvalReportKind.DEFECT:
            raise RuntimeError(f"a simulation process failed: {report.detail}")
        return report.result

    def _after_end(self, seat: DriverProcess, ended: DriverEnded, waiting: deque[EvalTask]) -> EpisodeResult | None:
        task = seat.current
        if task is None:
            return None
        if ended.fault is not None and self._made() is not None:
            return result_of_end(task, ended.detail, ended.fault, ended.state)
        if ended.fault is not None:
            raise WorldError(f"policy {task.policy} cannot be created: {ended.detail}")
        self._deaths[task.number] = self._deaths.get(task.number, 0) + 1
        if self._deaths[task.number] >= _TRIES:
            raise WorldError(f"{task.request.spec.spec_id}: the simulation failed {_TRIES} times: {ended.detail}")
        seat.current = None
        waiting.appendleft(task)
        return None

    def _made(self) -> DriverProcess | None:
        """A seat in which the policy could be made."""
        return next((seat for seat in self._seats if self._policy in seat.made), None)

    def _keep(self, result: EpisodeResult) -> None:
        seat = self._made()
        if seat is not None and self._store.note_of(self._policy) is None:
            self._store.note(note_of(self._policy, seat.made[self._policy], seat.renderer))
        self._store.add(result)
