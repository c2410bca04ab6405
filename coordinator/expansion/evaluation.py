"""Defines the jobs of an evaluation, which replace the draws of a plan, with a payload per job.

The module does not interpret the payloads; the evaluation writes them and the simulations read them.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import NamedTuple

from coordinator.expansion.draw import PlannedJob
from schemas.wire import Attachment

__all__ = ["Errands", "EvalPayload"]


class EvalPayload(NamedTuple):
    """Payload for the simulation of a job."""

    text: str
    """Text for the simulation."""
    attachment: Attachment | None = None
    """File that the worker fetches; `None` for none."""


@dataclass(frozen=True)
class Errands:
    """Jobs of an evaluation run; its plan defines the scenes and the settings only."""

    planned: tuple[PlannedJob, ...]
    """Jobs of a new ledger."""
    find: Callable[[int], EvalPayload]
    """Function that returns the payload of a job by its index."""
    files: Mapping[str, Path] = field(default_factory=dict)
    """Attached files by SHA-256."""
