"""Models of the report of an export."""

from __future__ import annotations

from schemas.base import Model


class Skip(Model):
    """Episode that could not be exported, with the reason."""

    episode_id: str
    reason: str


class ExportReport(Model):
    """Report of an export."""

    dataset: str
    dataset_digest: str
    """Digest of the selected episodes."""
    format: str
    out: str
    episodes: int
    """Number of episodes in the export."""
    frames: int
    """Number of frames in the export."""
    resumed: int
    """Number of episodes that earlier, interrupted calls exported."""
    skipped: tuple[Skip, ...]
    absent: tuple[str, ...]
    """Ids of planned episodes that the dataset does not have, because the run is unfinished or has abandoned them;
    empty if episodes were selected by id."""
    bytes: int
    """Size of the export, bytes."""
    seconds: float
    """Wall time of this call, seconds."""
    frames_per_second: float | None
    """Frames per second of this call; null if it wrote no episode."""
    complete: bool
    """Whether the export contains all selected episodes."""

    @property
    def finished(self) -> bool:
        """Whether the export has ended and is usable; some episodes may have been skipped."""
        return self.complete or bool(self.skipped)
