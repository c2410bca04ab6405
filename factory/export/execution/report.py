"""What an export says of itself when it ends. Models only."""

from __future__ import annotations

from schemas.base import Model

__all__ = ["ExportReport", "Skip"]


class Skip(Model):
    """An episode that could not be exported."""

    episode_id: str
    reason: str


class ExportReport(Model):
    """The outcome of an export."""

    dataset: str
    dataset_digest: str
    """Of the episodes that were asked for."""
    format: str
    out: str
    episodes: int
    """In the export now."""
    frames: int
    """In the export now."""
    resumed: int
    """Episodes that an earlier, interrupted call had brought."""
    skipped: tuple[Skip, ...]
    absent: tuple[str, ...]
    """Planned episodes that the dataset does not hold, as a run is not finished or gave them up; none where certain
    episodes were asked for."""
    bytes: int
    """Size of the export."""
    seconds: float
    """Wall time of this call."""
    frames_per_second: float | None
    """Of this call; null when it wrote no episode."""
    complete: bool
    """Whether all episodes that were asked for are in it."""

    @property
    def finished(self) -> bool:
        """Whether the export can be used: it was not interrupted."""
        return self.complete or bool(self.skipped)
