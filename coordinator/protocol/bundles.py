"""Bundles on their way into the archive: announced, to be transferred, to be validated. Transfers and reads nothing."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path
from typing import NamedTuple, TypeVar

from schemas.errors import InvalidBundle
from schemas.job import Job
from schemas.protocol.messages import Lease
from schemas.scene import Target


@dataclass(frozen=True)
class BuildJob:
    """Job to build the package of a layout."""

    index: int
    """Number of the job."""
    layout: str
    """Name of the layout."""
    number: int
    """Place of the layout in `plan.parts`."""


@dataclass(frozen=True)
class Pull:
    """Announced bundle in a worker's spool: an episode, or the package of a layout."""

    lease: Lease
    """Lease of the job."""
    sid: str
    """Session id of the worker."""
    sha256: str
    """Announced SHA-256."""
    size: int
    """Announced size, bytes."""
    job: Job | BuildJob
    """Job of the bundle."""
    candidates: tuple[Target, ...]
    """Targets of the compiled scene that the episode may have; none for a package."""
    via: str | None = None
    """zenoh id of the router that the worker is connected to; `None` if unknown."""
    is_validated: bool = False
    """Whether the worker has announced that it validated the bundle."""

    @property
    def name(self) -> str:
        """Name of the episode or of the layout."""
        return self.job.layout if isinstance(self.job, BuildJob) else self.job.episode_id


class Scope(StrEnum):
    """Part of a bundle that is validated."""

    ALL = "all"  # every frame and measurement
    SAMPLE = "sample"  # one frame and measurement in eight; all arrays
    CLAIM = "claim"  # container, arrays, job, target and content digest; for bundles that the worker has validated


R = TypeVar("R")


class BundleFile(NamedTuple):
    """Bundle to validate."""

    path: Path
    """Path of the bundle, usually a part file."""
    job: Job
    """Leased job."""
    candidates: tuple[Target, ...] = ()
    """Targets of the compiled scene that the episode may have; if empty, they are not compared."""
    scope: Scope = Scope.ALL
    """Part of the bundle that is read."""
    sha256: str | None = None
    """SHA-256 of the file, if this process has computed it; otherwise the validator does."""


def check_each(
    check: Callable[[Path, Job, tuple[Target, ...], Scope], R], files: Sequence[BundleFile]
) -> list[R | InvalidBundle]:
    """Validates bundles one after another; returns the result or the violations of each."""
    found: list[R | InvalidBundle] = []
    for file in files:
        try:
            found.append(check(file.path, file.job, file.candidates, file.scope))
        except InvalidBundle as error:
            found.append(error)
    return found
