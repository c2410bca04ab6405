"""Options that several formats share, and the computation of the frame stride. Pure."""

from __future__ import annotations

from pydantic import Field

from factory.export.base import Options
from schemas.dataset_meta import DatasetMeta
from schemas.errors import UsageError

__all__ = ["Decimated", "stride_of"]


class Decimated(Options):
    """Options of a format with a selectable frame rate."""

    fps: int | None = Field(
        default=None,
        ge=1,
        le=240,
        description="Frame rate, 1/s, a divisor of the dataset's rate. Default: the dataset's rate.",
    )

    def check(self, meta: DatasetMeta) -> None:
        """Validates that the rate divides the recorded rate."""
        stride_of(self.fps, meta.plan.task.control_hz)


def stride_of(fps: int | None, recorded_hz: int) -> int:
    """Returns the stride n: every n-th recorded frame is exported.

    Raises:
        UsageError: the requested rate does not divide the recorded rate.
    """
    wanted = recorded_hz if fps is None else fps
    if wanted < 1 or recorded_hz % wanted:
        rates = ", ".join(str(rate) for rate in range(1, recorded_hz + 1) if recorded_hz % rate == 0)
        raise UsageError(f"--fps {wanted}: the dataset has {recorded_hz} frames per second; valid values: {rates}")
    return recorded_hz // wanted
