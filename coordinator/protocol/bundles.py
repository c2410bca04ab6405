"""Bundle on its way into the archive: announced by a worker, fetched into a part file. Transfers nothing."""

from __future__ import annotations

from dataclasses import dataclass

from coordinator.archive.contract import PartFile
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


@dataclass(eq=False)
class IncomingBundle:
    """Announced bundle in a worker's spool, an episode or the package of a layout, and its transfer so far.

    The transfer may take several turns.
    """

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
    part: PartFile | None = None
    """Part file; `None` before the first turn."""
    seconds: float = 0.0
    """Transfer time so far, seconds."""
    is_alone: bool = False
    """Whether the bundle is fetched alone, because fetching it together with others has failed."""
    is_refused: bool = False
    """Whether the bundle was refused before it was complete."""

    @property
    def name(self) -> str:
        """Name of the episode or of the layout."""
        return self.job.layout if isinstance(self.job, BuildJob) else self.job.episode_id

    @property
    def open_part(self) -> PartFile:
        """Part file of a started transfer."""
        assert self.part is not None
        return self.part

    @property
    def rest(self) -> int:
        """Number of bytes to fetch."""
        return self.size - self.open_part.size

    def abandon(self) -> None:
        """Deletes the part file unless it is published; a repeated announcement begins a new transfer."""
        if self.part is not None:
            self.part.abandon()
        self.part, self.seconds, self.is_refused = None, 0.0, False

    def restart(self) -> None:
        """Deletes the part file; the next turn fetches the bundle from its beginning, without other bundles."""
        self.abandon()
        self.is_alone = True
