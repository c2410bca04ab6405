"""Exception classes of all packages: one base class, and a few subclasses that differ in the reaction of the caller.

Does not format errors for a terminal and does not define exit codes; the CLI maps the classes to exit codes.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Self


class FactoryError(Exception):
    """Base class of all errors that this product raises deliberately; the message names the remedy."""


class UsageError(FactoryError):
    """Invalid request by the caller: a value that does not exist, or values that conflict (exit code 2)."""


class WorldError(FactoryError):
    """Failure caused by data or environment: full disk, missing coordinator, scene without targets (exit code 1)."""


class RunFinished(WorldError):
    """The run is finished and its coordinator has ended, so no worker is needed."""


class LayoutError(WorldError):
    """Seed that gives no valid layout of a built-in scene; the caller tries another seed."""


class TransientError(FactoryError):
    """Temporary failure: the outcome is unknown or the peer does not answer; the caller retries with the same ids."""


class LeaseLost(FactoryError):
    """Loss of a lease: another worker holds the job now, and the caller discards its work."""


class ArchiveCorrupt(WorldError):
    """Stored data that contradicts the ledger or its own digests; `factory verify --deep` lists the damage."""


class Findings(WorldError):
    """Error that lists all findings, not only the first."""

    def __init__(self, what: str, findings: Sequence[str]) -> None:
        self.what, self.findings = what, tuple(findings)
        super().__init__(f"{what}:\n" + "\n".join(f"  - {finding}" for finding in self.findings))

    def __reduce__(self) -> tuple[type[Self], tuple[str, tuple[str, ...]]]:
        # without this, an error of a child process cannot be unpickled, which breaks its pool: "a process died"
        return type(self), (self.what, self.findings)


class InvalidBundle(Findings):
    """Bundle that violates the format or the limits of motion; lists every violation."""


class InvalidPlan(Findings, UsageError):
    """Plan that contradicts itself or its scenes; lists every mistake with its key."""


class InvalidRig(Findings, UsageError):
    """Rig that contradicts itself or the control rate; lists every mistake with its key."""


class InvalidAppearance(Findings, UsageError):
    """Appearance that contradicts itself; lists every mistake with its key."""


class InvalidLanguage(Findings, UsageError):
    """Language file with mistakes, or one that no target of a scene can satisfy; lists every mistake."""
