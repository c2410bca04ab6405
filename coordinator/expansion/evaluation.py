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
    """Jobs of a new ledger."""
    find: Callable[[int], EvalPayload]
    """Function that returns the payload of a job by its index."""
    files: Mapping[str, Path] = field(default_factory=dict)
    """Attached files by SHA-256."""
