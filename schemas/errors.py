"""The error family all packages share: one root, few children, each named for what the caller does next.

Never formats for a terminal and never decides an exit code; the CLI maps these classes to codes.
"""

from __future__ import annotations

from collections.abc import Sequence

__all__ = [
    "ArchiveCorrupt",
    "FactoryError",
    "InvalidBundle",
    "InvalidPlan",
    "LeaseLost",
    "TransientError",
    "UsageError",
    "WorldError",
]


class FactoryError(Exception):
    """Root of every error this product raises on purpose; the message names the remedy."""


class UsageError(FactoryError):
    """The caller asked for something that does not exist or contradicts itself (exit code 2)."""


class WorldError(FactoryError):
    """The data or the world said no: a full disk, a missing coordinator, a scene without targets (exit code 1)."""


class TransientError(FactoryError):
    """The outcome is unknown or the other side is away: try again later with the same ids."""


class LeaseLost(FactoryError):
    """Somebody else owns the job now: drop the work, it is not wanted any more."""


class ArchiveCorrupt(WorldError):
    """What lies on disk contradicts the ledger or its own digests: run `factory verify --deep`."""


class _Findings(WorldError):
    """An error that carries all findings, not only the first."""

    def __init__(self, what: str, findings: Sequence[str]) -> None:
        self.findings = tuple(findings)
        super().__init__(f"{what}:\n" + "\n".join(f"  - {finding}" for finding in self.findings))


class InvalidBundle(_Findings):
    """A bundle breaks the format or the laws of motion; carries every violation found."""


class InvalidPlan(_Findings, UsageError):
    """A plan contradicts itself or requires what its scenes do not have; carries every mistake with its key."""
