"""Defines the models of a repair report, for text output and `--json`. Opens no file."""

from __future__ import annotations

from enum import StrEnum

from schemas.base import Model


class RepairKind(StrEnum):
    """Kind of a repair action."""

    REBUILD = "rebuild"  # the ledger is lost or damaged: rebuilt from plan, tables and archive
    RESTORE = "restore"  # a scene package or a texture is missing or damaged: taken from the cache or compiled
    # again; an episode in quarantine is intact and of the plan: moved back and recorded
    ADOPT = "adopt"  # an intact episode without a ledger record: validated and recorded
    QUARANTINE = "quarantine"  # a file that is not an intact episode of this plan, or a texture that no scene needs:
    # moved to the quarantine folder
    REQUEUE = "requeue"  # a recorded episode without a file: collected again, with the same content
    REWRITE = "rewrite"  # a table that is missing or differs from the ledger: written again


class Action(Model):
    """Repair action."""

    kind: RepairKind
    """Kind of the action."""
    what: str
    """File relative to the root of the dataset, or episode id."""
    why: str
    """Reason, with measured values."""


class RepairReport(Model):
    """Report of a repair."""

    dataset: str
    """Root of the dataset."""
    run: str
    """Name of the run."""
    applied: bool
    """Whether the actions were applied; `False` for a dry run."""
    actions: tuple[Action, ...]
    """Actions in the order of their application."""
    episodes: int
    """Number of archived episodes after the actions."""
    planned: int
    """Number of planned episodes."""

    @property
    def is_sound(self) -> bool:
        """Whether the dataset needs no action."""
        return not self.actions
