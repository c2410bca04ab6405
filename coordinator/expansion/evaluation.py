"""Jobs of an evaluation, one for each task, which replace the draws of a plan. Does not interpret the tasks."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path

from coordinator.expansion.draw import PlannedJob
from schemas.protocol.messages import EvalPayload


@dataclass(frozen=True)
class EvalJobs:
    """Jobs of an evaluation run; its plan defines the scenes and the settings only."""

    planned: tuple[PlannedJob, ...]
    """Jobs of a new ledger."""
    find: Callable[[int], EvalPayload]
    """Function that returns the payload of a job by its index."""
    files: Mapping[str, Path] = field(default_factory=dict)
    """Attached files by SHA-256."""
