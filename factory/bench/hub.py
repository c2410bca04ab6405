"""The coordinator under test, in a process of its own, so that its memory is nobody else's. Times only its start."""

from __future__ import annotations

import time
from multiprocessing.connection import Connection
from pathlib import Path

import structlog

from coordinator.expansion.catalog import Catalog
from coordinator.options import CoordinatorOptions
from coordinator.service import Coordinator
from coordinator.settings import CoordinatorSettings
from factory.bench.machine import measure_memory, resident_mib
from factory.bench.model import Memory
from factory.support.logs import configure_logs
from schemas.base import Model
from schemas.dataset import EpisodeSummary, summary_of
from schemas.episode import EpisodeMeta
from schemas.job import Job
from schemas.plan import Plan
from schemas.scene import Target

__all__ = ["Condition", "Opened", "serve_hub"]

_LEASE_S = 600.0
"""No lease runs out while a busy machine is measured."""


class Opened(Model):
    """A coordinator that can be asked."""

    endpoints: tuple[str, ...]
    seconds: float
    """From the call to the moment at which it listens: ledger checked, archive reconciled."""


class Condition(Model):
    """How a coordinator does."""

    memory: Memory
    cpu_s: float
    """CPU time of its process so far, all threads."""


class _Trust:
    """Takes every bundle for a good one: what is timed is the way there, not the check in a process of its own."""

    def __init__(self, meta: EpisodeMeta, sha256: str, size: int) -> None:
        self._meta, self._sha256, self._size = meta, sha256, size

    def check(self, path: Path, job: Job, target: Target | None = None) -> EpisodeSummary:  # noqa: ARG002
        job = self._meta.job.model_copy(update={"index": job.index})
        meta = self._meta.model_copy(update={"job": job, "episode_id": job.episode_id})
        return summary_of(meta, self._sha256, self._size)

    def close(self) -> None:
        pass


def serve_hub(
    pipe: Connection, root: Path, plan: Plan, catalog: Catalog, meta: EpisodeMeta, sha256: str, size: int
) -> None:
    """Opens a coordinator, tells where it listens, and answers every message with its condition until the pipe ends.

    Args:
        pipe: to the conductor; the first thing sent is `Opened`, all others are `Condition`.
        root: of the dataset; its ledger may be filled already.
        plan: what the ledger holds.
        catalog: its scenes.
        meta: of the episode that every bundle is taken for.
        sha256: of every bundle.
        size: bytes of every bundle.
    """
    configure_logs(verbose=False)
    structlog.configure(wrapper_class=structlog.make_filtering_bound_logger(40))
    settings = CoordinatorSettings(lease_ttl_s=_LEASE_S, reserve_bytes=0)
    begun = time.perf_counter()
    checker = _Trust(meta, sha256, size)
    with Coordinator(
        root, plan, catalog, CoordinatorOptions(listen=("tcp/127.0.0.1:0",), settings=settings, checker=checker)
    ) as hub:
        pipe.send(Opened(endpoints=hub.endpoints, seconds=time.perf_counter() - begun))
        start_mib = resident_mib()
        try:
            while True:
                pipe.recv()
                pipe.send(Condition(memory=measure_memory(start_mib), cpu_s=time.process_time()))
        except EOFError:
            return
