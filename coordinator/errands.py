"""Jobs that a list names one by one, in the place of a plan's draws; each with a text for whoever carries it out.

Holds them; what the texts say is read by those who wrote them and by the simulations that they are for.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from coordinator.draw import PlannedJob

__all__ = ["Errands"]


@dataclass(frozen=True)
class Errands:
    """What a run of errands gives out; its plan names the scenes and the settings only."""

    planned: tuple[PlannedJob, ...]
    """The jobs that a new ledger is begun with."""
    text_of: Callable[[int], str]
    """Returns what the simulation of a job is told, by the job's index."""
