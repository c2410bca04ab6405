"""Runs a campaign on many machines: its tasks are the jobs of a run with ledger, leases and workers.

Every result is archived once, then stored once. An interrupted campaign can be resumed. Runs no episodes.

Design: docs/design/evaluation.md#a-distributed-evaluation-is-a-separate-run.
"""

from __future__ import annotations

import contextlib
import dataclasses
import queue
import shutil
import threading
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path

from coordinator.clock import utc_now
from coordinator.expansion.draw import EvalJobs
from coordinator.ledger import administration
from coordinator.ledger.database.engine import open_writer
from coordinator.ledger.opening import FormerFormat, holds_run, ledger_url_of
from coordinator.ledger.reading.audit import ledger_trouble
from coordinator.ledger.reading.reader import open_ledger
from coordinator.ledger.reading.records import JobFilter, list_jobs, read_archived
from coordinator.ledger.states import JobState
from coordinator.options import CoordinatorOptions
from coordinator.protocol.ask import ask_presence
from coordinator.protocol.tls import Guard
from coordinator.service import Coordinator
from coordinator.settings import CoordinatorSettings
from factory.eval.models.messages import EvalTask
from factory.eval.policies.made_from import another_policy
from factory.eval.process.driver_process import describe_wait
from factory.eval.process.local_campaign import Pace
from factory.eval.remote.results import ResultValidator, read_result_bundle
from factory.eval.remote.tasks import attachments_of, catalog_of, number_tasks, plan_of, planned_of
from factory.eval.results.store import Store
from factory.eval.specs.campaign import Campaign, with_actions
from schemas.dataset.rows import file_name_of
from schemas.errors import UsageError, WorldError
from schemas.job import episode_id
from schemas.plan import Plan
from schemas.protocol.messages import EvalPayload, PolicyWait

_FOLDER = "fleet"
_SETTINGS = CoordinatorSettings(reserve_bytes=64 << 20, lease_limit_s=86_400.0)
"""Small disk reserve, because results are small. Long leases, because each action may take up to the time limit of the
policy."""
_POLL_S = 0.5
_NAMED = 5


@dataclass(frozen=True)
class FleetAccess:
    """Network access to the workers."""

    listen: tuple[str, ...] = ()
    """Endpoints to which workers connect."""
    connect: tuple[str, ...] = ()
    """Endpoints of running coordinators whose workers run the episodes."""
    guard: Guard | None = None
    """TLS certificates for listening or connecting; `None` without TLS."""
    tell: Callable[[tuple[str, ...]], None] = lambda _endpoints: None
    """Called with the endpoints when the coordinator listens."""


def run_fleet(
    campaign: Campaign,
    plan: Plan,
    store: Store,
    access: FleetAccess,
    stop: threading.Event,
    tell: Callable[[Pace], None],
) -> bool:
    """Runs every unfinished episode on workers; returns whether all are finished, false when `stop` was set earlier.

    Args:
        campaign: Campaign to run.
        plan: Plan of the dataset.
        store: Store of the results.
        access: Network access to the workers.
        stop: Event that stops the campaign gracefully; results received so far are kept.
        tell: Progress callback, called for each policy.

    Raises:
        UsageError: The specs do not match the dataset, or an older version started the campaign.
        TransientError: No coordinator replies at the endpoints to connect to.
        WorldError: Episodes failed; the message contains the reasons.
    """
    tasks = number_tasks(campaign)
    intake = ResultCollector(store, tasks, tell)
    if not intake.left:
        return True
    attached = attachments_of(campaign)
    run_plan, catalog = plan_of(campaign, plan, tasks, attached), catalog_of(campaign)
    root = store.root / _FOLDER / run_plan.run

    def find(index: int) -> EvalPayload:
        task = with_actions(tasks[index], campaign.root)
        attachment, _ = attached.get(task.policy, (None, None))
        return EvalPayload(task=task.model_dump_json(), attachment=attachment)

    planned = tuple(map(planned_of, intake.left.values()))
    files = {attachment.sha256: path for attachment, path in attached.values()}
    evaluation = EvalJobs(planned, find, files, intake.note_wait)
    if access.connect:
        _require_coordinator(access)
    _try_failed_again(root)
    options = CoordinatorOptions(
        listen=access.listen,
        settings=_SETTINGS,
        guard=access.guard,
        checker=ResultValidator(tasks),
        evaluation=evaluation,
        connect=access.connect,
    )
    with Coordinator(root, run_plan, catalog, options) as coordinator:
        access.tell(coordinator.endpoints)
        is_over = _take_results(coordinator, intake, root, stop)
    if is_over:
        _require_whole(root, store)
        shutil.rmtree(root, ignore_errors=True)  # all content of the folder is in the results
        with contextlib.suppress(OSError):
            root.parent.rmdir()  # fails if the folder contains another campaign
    return is_over


def _take_results(coordinator: Coordinator, intake: ResultCollector, root: Path, stop: threading.Event) -> bool:
    """Stores results until all episodes are finished or `stop` is set; returns whether all are finished."""
    while not stop.is_set():
        is_over = coordinator.wait(_POLL_S, stop)
        intake.tell_waits()
        intake.take(root)
        if is_over:
            coordinator.wait_for_workers_to_disconnect(stop)
            return True
    return False


def _require_coordinator(access: FleetAccess) -> None:
    """Raises an error if no coordinator replies."""
    if access.guard is None:
        ask_presence(access.connect)
    else:
        ask_presence(access.connect, access.guard.name, access.guard.files)


def _try_failed_again(root: Path) -> None:
    """Returns failed tasks to the queue, because their error message asks the user to run the command again."""
    try:
        trouble = ledger_trouble(ledger_url_of(root))
    except FormerFormat as error:
        raise UsageError(
            f"the ledger of the unfinished evaluation in {root} {error.why}: delete this folder, and run the command "
            "again; results that are stored already are kept"
        ) from error
    if trouble:
        return  # no ledger, or a damaged one, which the coordinator rebuilds when it starts
    engine = open_writer(ledger_url_of(root))
    try:
        with engine.begin() as connection:
            if holds_run(connection):
                administration.retry(connection, (), utc_now())
    finally:
        engine.dispose()


def _require_whole(root: Path, store: Store) -> None:
    with open_ledger(ledger_url_of(root)) as connection:
        failed = list_jobs(connection, JobFilter(states=(JobState.FAILED,)), limit=_NAMED)
    # the jobs are not released again: if no worker has the module of the policy, the evaluation would never end
    if failed:
        reasons = "\n".join(f"  - {job.episode.target_id} in {job.episode.scene}: {job.reason}" for job in failed)
        raise WorldError(
            f"some episodes could not be run; the results of the others are in {store.root}. Correct the cause and run "
            f"the same command again:\n{reasons}"
        )


class ResultCollector:
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
        self._waits: queue.SimpleQueue[tuple[int, PolicyWait]] = queue.SimpleQueue()
        self._shown_waits: set[tuple[str, PolicyWait]] = set()
        for policy in policies:
            self._tell(self._pace(policy))

    def note_wait(self, index: int, wait: PolicyWait) -> None:
        """Records that a worker waits long for the policy of a task; called in another thread."""
        self._waits.put((index, wait))

    def tell_waits(self) -> None:
        """Reports the waits that were recorded since the last call, each kind once for each policy."""
        while not self._waits.empty():
            index, wait = self._waits.get()
            task = self._tasks.get(index)
            if task is not None and (task.policy, wait) not in self._shown_waits:
                self._shown_waits.add((task.policy, wait))
                self._tell(dataclasses.replace(self._pace(task.policy), waiting=describe_wait(wait, task.setup)))

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
                driven = read_result_bundle(file)
            policy = driven.result.policy
            stored = self._store.note_of(policy)
            if stored is None:
                self._store.note(driven.note)
            elif error := another_policy(policy, stored.made_from, driven.note.made_from, self._store.root):
                raise error
            self._store.add(driven.result)
            self._done[index] = driven.result.success
            self._tell(self._pace(policy))

    def _pace(self, policy: str) -> Pace:
        numbers = [index for index, task in self._tasks.items() if task.policy == policy]
        done = [self._done[index] for index in numbers if index in self._done]
        return Pace(policy, len(done), len(numbers), sum(done))
