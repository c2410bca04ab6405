"""Runs one shard of a run: records its state in `run_shard.json`, and decides whether its lock may be taken over.

The state file is the heartbeat of a shard. A reader waits for a change of the file and does not use its times, so the
clocks of the hosts may differ. Generates no episode.

Design: docs/design/protocol.md#shards-of-a-run-are-contiguous.
"""

from __future__ import annotations

import socket
import threading
import time
from dataclasses import dataclass, field
from datetime import UTC, datetime

from coordinator.archive.objects import other_holder
from coordinator.expansion.catalog import Catalog
from coordinator.ledger.opening import require_shard
from factory.dataset.site import Site
from factory.runs.ledger import shard_of
from schemas.dataset.run_shard import RunShard, ShardState, read_shard_state, to_text
from schemas.errors import UsageError, WorldError
from schemas.plan import Plan
from schemas.protocol.status import Progress
from schemas.storage.dataset_files import RUN_SHARD_FILE
from schemas.storage.disk import replacing
from schemas.storage.object_path import ObjectPath
from schemas.support.product import product_version

_INTERVAL_S = 30.0
"""Minimum time between two writes of the state, seconds."""
_PATIENCE_S = 4 * _INTERVAL_S
"""Time without a change of the state after which a lock in object storage counts as abandoned, seconds."""
_PAUSE_S = 2.0


def choose_shard(
    site: Site, wanted: RunShard | None, plan: Plan, ledger: str | None = None, *, is_new: bool
) -> RunShard | None:
    """Returns the shard to run in a directory: the one that it contains, or the requested one.

    Args:
        site: location of the shard.
        wanted: value of `--shard`; `None` continues the shard that the directory contains.
        plan: plan of the run.
        ledger: URL of the ledger, if it is not in the directory.
        is_new: whether the directory contains no run yet.

    Raises:
        UsageError: the directory contains the whole run or another shard, or the plan has too few episodes.
    """
    recorded = shard_of(site, ledger)
    if wanted is None:
        return recorded
    if not is_new or recorded is not None:
        require_shard(recorded, wanted)
    if wanted.count > plan.episodes:
        raise UsageError(
            f"--shard {wanted}: plan {plan.name} has {plan.episodes} episodes; use at most {plan.episodes} shards"
        )
    return wanted


def may_take_over(
    site: Site, stop: threading.Event, patience_s: float = _PATIENCE_S, pause_s: float = _PAUSE_S
) -> bool:
    """Returns whether a killed process left the lock of a shard in object storage; waits until that is certain.

    Args:
        site: location of the shard.
        stop: event that ends the wait.
        patience_s: time without a change of the state after which the lock counts as abandoned, seconds.
        pause_s: time between two requests, seconds.

    Raises:
        WorldError: another process runs the shard.
    """
    if site.store is None or read_shard_state(site.store) is None:
        return False
    seen, waited_s = read_shard_state(site.store), 0.0
    while holder := other_holder(site.store, site.state_dir):
        if read_shard_state(site.store) != seen:
            raise WorldError(f"another process runs the shard {site}: stop it first; its state directory: {holder}")
        if waited_s >= patience_s or stop.wait(pause_s):
            return waited_s >= patience_s
        waited_s += pause_s
    return False


@dataclass
class ShardRecorder:
    """Writer of the state of one running shard."""

    site: Site
    """Location of the shard."""
    shard: RunShard
    """The shard."""
    plan: Plan
    """Plan of the run."""
    catalog: Catalog
    """Compiled scenes of the plan."""
    _written: float | None = field(default=None, init=False)

    def record(self, progress: Progress) -> None:
        """Writes the state, at most every half minute; called while the shard is locked.

        Raises:
            WorldError: another process has taken the shard over, or the file cannot be written.
        """
        now = time.monotonic()
        if self._written is not None and now - self._written < _INTERVAL_S:
            return
        if self.site.store is not None and (holder := other_holder(self.site.store, self.site.state_dir)):
            raise WorldError(f"another process has taken over the shard {self.site}; its state directory: {holder}")
        self._write(progress)
        self._written = now

    def finish(self, progress: Progress) -> None:
        """Writes the last state; called after the tables were written."""
        self._write(progress, finished=progress.finished)

    def _write(self, progress: Progress, *, finished: bool = False) -> None:
        path = self.site.place / RUN_SHARD_FILE
        former = read_shard_state(self.site.place)
        versions = {product_version(), *(() if former is None else former.versions)}
        state = ShardState(
            shard=self.shard,
            run=self.plan.run,
            plan_digest=self.plan.digest,
            versions=tuple(sorted(versions)),
            scenes={name: entry.sha256 for name, entry in self.catalog.items()},
            host=socket.gethostname(),
            planned=progress.planned,
            jobs=progress.jobs,
            attempts=progress.attempts,
            finished=finished,
            updated_at=datetime.now(UTC),
        )
        text = to_text(state)
        if isinstance(path, ObjectPath):
            path.objects.put(path.key, text.encode())
            return
        with replacing(path) as part:
            part.write_text(text, encoding="utf-8")
