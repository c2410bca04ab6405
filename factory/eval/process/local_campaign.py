"""Runs a campaign on one machine: policies x variants x episodes on driver processes; stores results as they finish.

Owns the driver processes and kills them at the end. Prints nothing; a callback receives the progress.
"""

from __future__ import annotations

import dataclasses
import threading
from collections import Counter, deque
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from dataclasses import dataclass

from factory.eval.models.messages import DriverOrder, EvalReport, EvalReportKind, EvalTask
from factory.eval.models.result import REAL, EpisodeResult
from factory.eval.policies.made_from import another_policy
from factory.eval.policies.registry import note_of, renders_apart
from factory.eval.process.driver_process import DriverEnded, DriverProcess, describe_wait, interrupted_result
from factory.eval.results.store import Store
from factory.eval.specs.campaign import Campaign, tasks_for, with_actions
from factory.eval.specs.from_dataset import LoadedScenes
from schemas.errors import UsageError, WorldError
from schemas.protocol.messages import PolicyWait

_POLL_S = 0.05
_TRIES = 2
"""Number of attempts at an episode in which the driver process dies outside of policy calls. After the last one, the
campaign stops with an error."""


_TIMES = {"act_ms", "seconds"}
"""Fields of a result that are not reproducible."""


def describe_difference(former: EpisodeResult, alone: EpisodeResult) -> str:
    """Returns how the result of an episode differs when it is driven alone; empty if only its times differ."""
    if former.model_dump(exclude=_TIMES) == alone.model_dump(exclude=_TIMES):
        return ""
    ends = [f"{one.end} after {one.num_steps} steps at {one.final_ne_m:.3f} m" for one in (former, alone)]
    return (
        f"{former.policy} keeps state between episodes: {former.spec_id} ended with {ends[0]}, and alone in a new "
        f"process with {ends[1]}. Its results depend on the order of the episodes and on --workers: restore "
        "the initial state in reset()"
    )


@dataclass(frozen=True)
class Pace:
    """Progress of one policy in a campaign."""

    policy: str
    done: int
    """Finished episodes of the policy, including earlier runs."""
    total: int
    successes: int
    waiting: str = ""
    """What the policy is waited for, with the limit; empty unless a long wait begins."""


PaceCallback = Callable[[Pace], None]


def run_campaign(campaign: Campaign, store: Store, stop: threading.Event, tell: PaceCallback) -> bool:
    """Runs every unfinished episode; returns whether all are finished, which is false when `stop` was set earlier.

    Args:
        campaign: Campaign to run.
        store: Store of the finished episodes; receives the new results.
        stop: Event that stops the campaign immediately; finished episodes are kept.
        tell: Progress callback, called after every episode.

    Raises:
        UsageError: A policy cannot be created, or the specs do not match the dataset.
        WorldError: The server of a policy cannot be reached, or simulations die repeatedly.
    """
    places = LoadedScenes(campaign.root)
    with ExitStack() as stack:
        drivers = [DriverProcess() for _ in range(campaign.processes)]
        for driver in drivers:
            stack.callback(driver.kill)
        for policy in campaign.policies:
            if not _PolicyCampaign(campaign, policy, places, store, drivers, stop, tell).run():
                return False
    return True


class _PolicyCampaign:
    """Runs all episodes of one policy."""

    def __init__(
        self,
        campaign: Campaign,
        policy: str,
        places: LoadedScenes,
        store: Store,
        drivers: list[DriverProcess],
        stop: threading.Event,
        tell: PaceCallback,
    ) -> None:
        self._campaign, self._policy, self._store = campaign, policy, store
        self._tasks = tasks_for(campaign, policy, places)
        self._packages = {
            spec.scene_sha256: places.path(spec.scene, spec.scene_sha256) for spec in campaign.specs.specs
        }
        self._drivers, self._stop, self._tell = drivers, stop, tell
        self._deaths: dict[int, int] = {}
        self._driven: Counter[DriverProcess] = Counter()
        self._shown_waits: set[PolicyWait] = set()
        self._checked: dict[DriverProcess, dict[str, str]] = {}
        """Hashes of the policy that each process reported last, which agree with the stored ones."""
        self._repeatable: tuple[EvalTask, EpisodeResult] | None = None
        """Last episode that was not the first one of its process, with its result."""

    def run(self) -> bool:
        """Runs the unfinished episodes; returns whether all are finished."""
        tasks = self._tasks
        done = {result.key: result.success for result in self._store.results(self._policy)}
        waiting = deque(task for task in tasks if task.request.key not in done)
        successes = sum(done.get(task.request.key, False) for task in tasks)
        pace = Pace(self._policy, len(tasks) - len(waiting), len(tasks), successes)
        self._tell(pace)
        while pace.done < pace.total and not self._stop.is_set():
            for result in self._poll_drivers(waiting):
                self._keep(result)
                pace = Pace(self._policy, pace.done + 1, pace.total, pace.successes + result.success)
                self._tell(pace)
            if text := self._long_wait():
                self._tell(dataclasses.replace(pace, waiting=text))
        if pace.done < pace.total:
            return False
        self._repeat_alone()
        return True

    def _long_wait(self) -> str:
        """Returns the description of a wait that became long, each kind once; empty without one."""
        for driver in self._drivers:
            wait = driver.long_wait
            if wait is not None and wait not in self._shown_waits:
                self._shown_waits.add(wait)
                return describe_wait(wait, self._campaign.setup)
        return ""

    def _poll_drivers(self, waiting: deque[EvalTask]) -> Iterator[EpisodeResult]:
        """Sends a task to every idle driver, polls every busy one once, and yields the results."""
        busy = 0
        for driver in self._drivers:
            if driver.current is None and waiting:
                driver.send(self._order(waiting.popleft()))
            busy += driver.current is not None
        for driver in self._drivers:
            if driver.current is None:
                continue
            report = driver.poll(_POLL_S / max(1, busy))
            self._require_same(driver)
            if isinstance(report, DriverEnded):
                result = self._after_end(driver, report, waiting)
            else:
                result = self._after(report)
            if result is not None:
                task, driver.current = driver.current, None
                self._driven[driver] += 1
                if task is not None and self._driven[driver] > 1 and not result.end.is_of_the_policy:
                    self._repeatable = task, result
                yield result

    def _repeat_alone(self) -> None:
        """Repeats one episode in a new process, and notes a difference: then the policy depends on earlier episodes.

        The built-in policies without a network keep no state, and the state of a server is out of reach.
        """
        note = self._store.note_of(self._policy)
        if self._campaign.setup.latency == REAL:
            return  # the measured times differ
        if self._repeatable is None or not renders_apart(self._campaign.reference(self._policy)) or note is None:
            return
        (task, former), driver = self._repeatable, self._drivers[0]
        driver.kill()
        driver.send(self._order(task))
        result: EpisodeResult | None = None
        while result is None and not self._stop.is_set():
            report = driver.poll(_POLL_S)
            if isinstance(report, DriverEnded):
                return  # a fault that the campaign did not have; the next evaluation reports it
            result = self._after(report)
        driver.current = None
        if result is not None and (text := describe_difference(former, result)):
            self._store.note(note.model_copy(update={"order_dependence": text}))

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

    def _after_end(self, driver: DriverProcess, ended: DriverEnded, waiting: deque[EvalTask]) -> EpisodeResult | None:
        task = driver.current
        if task is None:
            return None
        if ended.fault is not None and self._made() is not None:
            return interrupted_result(task, ended.detail, ended.fault, ended.state)
        if ended.fault is not None:
            raise WorldError(f"policy {task.policy} cannot be created: {ended.detail}")
        self._deaths[task.number] = self._deaths.get(task.number, 0) + 1
        if self._deaths[task.number] >= _TRIES:
            raise WorldError(f"{task.request.spec.spec_id}: the simulation failed {_TRIES} times: {ended.detail}")
        driver.current = None
        waiting.appendleft(task)
        return None

    def _require_same(self, driver: DriverProcess) -> None:
        """Raises an error if a process has created another policy than that of the stored results.

        Raises:
            UsageError: it has; the message contains both hashes.
        """
        made = driver.made.get(self._policy)
        hashes = None if made is None else made.made_from
        if hashes is None or self._checked.get(driver) is hashes:  # a restarted process reports another dictionary
            return
        note = self._store.note_of(self._policy)
        if note is None:
            return
        self._checked[driver] = hashes
        if error := another_policy(self._policy, note.made_from, hashes, self._store.root):
            raise error

    def _made(self) -> DriverProcess | None:
        """Returns a driver process in which the policy has been created, or `None`."""
        return next((driver for driver in self._drivers if self._policy in driver.made), None)

    def _keep(self, result: EpisodeResult) -> None:
        driver = self._made()
        if driver is not None and self._store.note_of(self._policy) is None:
            self._store.note(note_of(self._tasks[0], driver.made[self._policy], driver.renderer))
        self._store.add(result)
