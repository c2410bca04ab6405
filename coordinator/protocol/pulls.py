"""Models of announced bundles, which the coordinator or a gateway pulls. This module transfers nothing."""

from __future__ import annotations

from dataclasses import dataclass

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
