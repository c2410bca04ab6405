"""What a verification says: findings about files, and the report that gathers them. Values only."""

from __future__ import annotations

from dataclasses import dataclass, field
from enum import StrEnum

from schemas.storage.place import Place

__all__ = ["Finding", "Kind", "VerifyReport"]


class Kind(StrEnum):
    """What is wrong, in one word."""

    MISSING = "missing"  # a table names it, the disk does not have it
    SURPLUS = "surplus"  # an episode file or split table that no row of the metadata names
    FOREIGN = "foreign"  # a file that is no part of a dataset
    TRUNCATED = "truncated"  # shorter or longer than recorded
    CHANGED = "changed"  # other bytes than recorded
    INVALID = "invalid"  # breaks the format, the laws of motion or its own digests
    CONTRADICTION = "contradiction"  # the tables say something else than the episode, the scene or the plan
    DAMAGED = "damaged"  # a table or scene that cannot be read


@dataclass(frozen=True)
class Finding:
    """One thing that is wrong."""

    kind: Kind
    file: str
    """Below the dataset's directory."""
    text: str
    """What was found, with values."""


@dataclass
class VerifyReport:
    """What a verification found."""

    root: Place
    deep: bool
    episodes: int = 0
    """In the tables."""
    complete: bool = False
    """Whether the dataset says that every planned episode is there."""
    digest: str | None = None
    """Of the dataset, from its tables; `None` when they cannot be read."""
    findings: list[Finding] = field(default_factory=list)

    @property
    def ok(self) -> bool:
        """Whether nothing is wrong."""
        return not self.findings

    def add(self, kind: Kind, file: str, text: str) -> None:
        """Notes a finding."""
        self.findings.append(Finding(kind, file, text))
