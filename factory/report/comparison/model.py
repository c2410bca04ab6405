"""One number of the paper beside ours: the model that the page, `report.json` and `--json` share. Values only."""

from __future__ import annotations

from schemas.base import Model

__all__ = ["PaperComparison"]


class PaperComparison(Model):
    """One number of the paper and ours."""

    exhibit: str
    """Name of the figure that it stands beside."""
    what: str
    ours: float | None
    """`None` where the dataset has nothing to measure."""
    published: float
    published_high: float | None = None
    """Upper end, where the paper gives a range."""
    unit: str
    """`m`, `steps`, `share` or empty for a plain number."""
    digits: int
    source: str
    reason: str = ""
    """Why they differ, with the number that shows it; empty where they do not differ noticeably."""

    @property
    def difference(self) -> float | None:
        """Ours less the paper's (its nearer end, 0 within a range)."""
        if self.ours is None:
            return None
        high = self.published if self.published_high is None else self.published_high
        return self.ours - min(max(self.ours, self.published), high)

    @property
    def ratio(self) -> float | None:
        """Ours over the paper's, where that is one number other than 0."""
        if self.ours is None or self.published_high is not None or self.published == 0:
            return None
        return self.ours / self.published
