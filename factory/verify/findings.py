"""Models of a verification: findings about files, and the report. Reads no files."""

from __future__ import annotations

from dataclasses import dataclass, field
from enum import StrEnum

from factory.verify.rendering import RenderDifference
from schemas.storage.place import Place


class Kind(StrEnum):
    """Kind of a finding."""

    MISSING = "missing"  # a table lists the file, but it does not exist
    SURPLUS = "surplus"  # an episode file or split table without a metadata row
    FOREIGN = "foreign"  # a file that is not part of a dataset
    TRUNCATED = "truncated"  # the size differs from the recorded size
    CHANGED = "changed"  # the SHA-256 differs from the recorded one
    INVALID = "invalid"  # violates the format, the motion limits or its own digests
    CONTRADICTION = "contradiction"  # the tables contradict the episode, the scene or the plan
    DAMAGED = "damaged"  # a table or scene that cannot be read
    RENDERED = "rendered"  # a frame that is rendered again differs from its digest


@dataclass(frozen=True)
class Finding:
    """Finding of a verification."""

    kind: Kind
    file: str
    """Path relative to the dataset directory."""
    text: str
    """Description of the finding, with values."""


@dataclass
class VerifyReport:
    """Result of a verification."""

    root: Place
    deep: bool
    episodes: int = 0
    """Number of episodes in the tables."""
    rendered: int = 0
    """Number of episodes whose frames were rendered again."""
    complete: bool = False
    """Whether the dataset is marked as complete."""
    digest: str | None = None
    """Digest of the dataset, computed from its tables; `None` when they cannot be read."""
    findings: list[Finding] = field(default_factory=list)
    difference: RenderDifference = field(default_factory=RenderDifference)
    """Comparison of the frames that were rendered again with the recorded ones."""

    @property
    def ok(self) -> bool:
        return not self.findings

    def add(self, kind: Kind, file: str, text: str) -> None:
        self.findings.append(Finding(kind, file, text))
