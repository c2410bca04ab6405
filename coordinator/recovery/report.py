"""Defines the models of a repair report, for text output and `--json`. Opens no file."""

from __future__ import annotations

from enum import StrEnum

from schemas.base import Model


class RepairKind(StrEnum):
    """Kind of a repair action."""

    # A lost or damaged ledger is rebuilt from plan, tables and archive.
    REBUILD = "rebuild"
    # A missing or damaged scene package or texture is taken from the cache or compiled again; an intact episode of the
    # plan is moved back from quarantine and recorded.
    RESTORE = "restore"
    # An intact episode without a ledger record is validated and recorded.
    ADOPT = "adopt"
    # A file that is not an intact episode of this plan, or a texture that no scene needs, is moved to quarantine.
    QUARANTINE = "quarantine"
    # A recorded episode without a file is collected again, with the same content.
    REQUEUE = "requeue"
    # A table that is missing or differs from the ledger is written again.
    REWRITE = "rewrite"


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
