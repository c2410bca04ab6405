"""What a repair finds and does, as plain models for people and for `--json`. Decides nothing, opens nothing."""

from __future__ import annotations

from enum import StrEnum

from schemas.base import Model

__all__ = ["Action", "RepairKind", "RepairReport"]


class RepairKind(StrEnum):
    """One kind of remedy."""

    REBUILD = "rebuild"  # the ledger is lost or damaged: made anew from plan, tables and archive
    RESTORE = "restore"  # a scene package is missing or damaged: taken from the cache or built again; an episode in
    # quarantine is whole and of the plan: moved back and recorded
    ADOPT = "adopt"  # a whole episode that the ledger does not own: validated and recorded
    QUARANTINE = "quarantine"  # a file that is no sound episode of this plan: moved aside and kept
    REQUEUE = "requeue"  # an episode that the ledger owns and the disk does not have: made anew, with the same content
    REWRITE = "rewrite"  # a table that is missing or does not say what the ledger says: written anew


class Action(Model):
    """One remedy."""

    kind: RepairKind
    what: str
    """File below the dataset's directory, or the episode."""
    why: str
    """Measured values, in words."""


class RepairReport(Model):
    """What was wrong with a dataset directory."""

    dataset: str
    run: str
    applied: bool
    """Whether the actions were carried out; not so in a dry run."""
    actions: tuple[Action, ...]
    episodes: int
    """Archived when done, or as it would be."""
    planned: int

    @property
    def is_sound(self) -> bool:
        """Whether there was nothing to do."""
        return not self.actions
