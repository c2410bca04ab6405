"""Jobs that a list names one by one, in the place of a plan's draws; each with a text for whoever carries it out.

Holds them; what the texts say is read by those who wrote them and by the simulations that they are for.
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
    """What the simulation of a job is told and given beside the job."""

    text: str
    attachment: Attachment | None = None


@dataclass(frozen=True)
class Errands:
    """What a run of errands gives out; its plan names the scenes and the settings only."""

    planned: tuple[PlannedJob, ...]
    """The jobs that a new ledger is begun with."""
    find: Callable[[int], EvalPayload]
    """Returns what goes with a job, by its index."""
    files: Mapping[str, Path] = field(default_factory=dict)
    """What is attached, by SHA-256."""
