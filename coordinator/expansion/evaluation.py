"""The jobs of an evaluation, one for each task, instead of the draws of a plan. Holds them; reads no task."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path

from coordinator.expansion.draw import PlannedJob
from schemas.wire import EvalPayload

__all__ = ["EvalJobs"]


@dataclass(frozen=True)
class EvalJobs:
    """What the coordinator of an evaluation gives out; its plan names the scenes and the settings only."""

    planned: tuple[PlannedJob, ...]
    """The jobs that a new ledger is begun with."""
    find: Callable[[int], EvalPayload]
    """Returns the task of a job, by the job's index."""
    files: Mapping[str, Path] = field(default_factory=dict)
    """What is attached, by SHA-256."""
